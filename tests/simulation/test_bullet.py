import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from envs.simulation import Twist, make_simulator
from tests.rooms import BURGER, ORIGIN, begin, square_room

ROOT = Path(__file__).parents[2]


def test_where_pybullet_is_missing_the_error_helps(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(ImportError, match=r"Linux x86_64 and Python 3\.11.*pip install pybullet.*'kinematic'"):
        make_simulator("bullet", BURGER, 0.1)
    make_simulator("kinematic", BURGER, 0.1)


def test_worlds_may_have_more_walls_than_fit_into_one_mesh(bullet):
    """A floor of 200 m x 60 m has 47,000 of them, circles included; the last one is as solid as the first."""
    xs = np.linspace(-9.0, 9.0, 35_000)
    far = np.column_stack([xs, np.full_like(xs, 9.0), xs, np.full_like(xs, 9.1)])
    simulator = begin(bullet, BURGER, square_room(10.0, [*far, [0.3, -1.0, 0.3, 1.0]]), ORIGIN)
    for _ in range(30):
        reading = simulator.step([Twist(0.2, 0.0)])[0]
    assert reading.bumper
    assert simulator.states[0].pose.x < 0.3


def test_pybullet_is_imported_late_and_silently(bullet):
    code = """
import sys
import numpy as np
from envs.robots import load_robot
from envs.simulation import Twist, make_simulator
from envs.worlds import load_world
robot = load_robot("turtlebot3_burger")
make_simulator("kinematic", robot, 0.1)
assert "pybullet" not in sys.modules
world = load_world("turtlebot3_world")
simulator = make_simulator("bullet", robot, 0.1)
simulator.reset(world, [world.spawns[0]], [np.random.default_rng(0)])
simulator.step([Twist(0.1, 0.0)])
simulator.close()
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")


def test_it_can_be_pickled_before_the_first_reset_and_closed_twice(bullet):
    simulator = pickle.loads(pickle.dumps(make_simulator(bullet, BURGER, 0.1)))
    simulator.close()
    for _ in range(2):
        simulator.reset(square_room(3.0), [ORIGIN], [np.random.default_rng(0)])
        simulator.step([Twist(0.1, 0.0)])
        simulator.close()
        simulator.close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_ever_new_worlds_do_not_fill_the_memory(bullet):
    rng = np.random.default_rng(0)
    simulator = make_simulator(bullet, BURGER, 0.1)

    def megabytes_after(num_worlds):
        for _ in range(num_worlds):
            corners = rng.uniform(1.0, 9.0, (2000, 2))
            segments = np.hstack([corners, corners + rng.uniform(-0.3, 0.3, corners.shape)])
            simulator.reset(square_room(10.0, segments), [ORIGIN], [rng])
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

    before = megabytes_after(4)
    assert megabytes_after(12) - before < 8.0, "2 MB are lost with every such world when lists are not reused"
