import os
import signal
import subprocess
import sys
import time

import pytest

POOL = """
import os, time
from lidarnaut.agents.pools import make_pool

if __name__ == "__main__":
    with make_pool(1) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        pool.submit(time.sleep, 600).result()
"""
VECTOR = """
import multiprocessing, time
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.vector import LidarVectorEnv

class Asleep(LidarEnv):
    def begin(self, **arguments):
        super().begin(**arguments)
        time.sleep(self.control_period)

if __name__ == "__main__":
    envs = [LidarVectorEnv(Asleep, 3, task=Explore, num_workers=3, physics="kinematic", context="fork")]
    # A process that does not follow, and holds copies of what was open when it was forked.
    other = multiprocessing.get_context("fork").Process(target=time.sleep, args=(25.0,))
    other.start()
    for method in ("forkserver", "spawn"):
        envs.append(LidarVectorEnv(Asleep, 2, task=Explore, num_workers=2, physics="kinematic", context=method))
        envs[-1].get_attr("control_period")  # once the worker is up
    envs[0].set_attr("control_period", [0.0, 600.0, 600.0])
    print(*{child.pid for child in multiprocessing.active_children()} - {other.pid}, flush=True)
    envs[0].reset(seed=0)
"""


def is_alive(pid):
    try:
        os.kill(pid, 0)
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize(("code", "count"), [(POOL, 1), (VECTOR, 4)])
def test_workers_end_with_their_parent_even_in_the_midst_of_a_task(tmp_path, code, count):
    script = tmp_path / "parent.py"
    script.write_text(code)
    parent = subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": os.getcwd()}
    )
    workers = [int(word) for word in parent.stdout.readline().split()]
    assert len(workers) == count
    assert all(map(is_alive, workers))
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    deadline = time.monotonic() + 15.0
    while any(map(is_alive, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_alive, workers))
