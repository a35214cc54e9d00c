"""What happens to a robot whose driver is left alone: `python -m tests.driver.alone [--only NAME] [--minutes 6]`.

`lidarnaut-drive` is a process of its own, as are the commands that it sends. The table gives the longest gap between
commands under load, the time to the first stop after each kind of loss, and memory and map of a long drive.
"""

import contextlib
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from PIL import Image

from lidarnaut.driver import serve
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.logs import messages

from .recorder import Recorder

TIMEOUT = 1.0


class Robot(serve.Server):
    """Simulated robot that is the connection of its own server. `imu`: further messages of the IMU per period."""

    def __init__(self, imu=0, **options):
        self.recorder, self.silent, self.imu, self.sent, self._taken = Recorder(), set(), imu, 0, 0
        how = {"world": "turtlebot3_world", "robot": "turtlebot3_burger", **options}
        super().__init__(serve.Options(**how), self)

    def advertise(self, *_, **__):
        pass

    def subscribe(self, *_):
        pass

    def publish(self, topic, message):
        if topic not in self.silent:
            self.sent += 1
            self.recorder.publish(topic, message)

    def step(self):
        for part in range(self.imu, 0, -1):
            stamp = messages.RESET_STAMP + self.robot.time - 0.02 * part / (self.imu + 1)
            self.publish("/imu", messages.imu(stamp, self.robot.reading.yaw_rate))
        super().step()

    def spin(self):
        commands = self.recorder.commands[self._taken :]
        self._taken += len(commands)
        for v, w in commands[-1:]:
            self._receive(SimpleNamespace(linear=SimpleNamespace(x=v), angular=SimpleNamespace(z=w)))

    @contextlib.contextmanager
    def driven(self, *options, folder, max_size=resource.RLIM_INFINITY):
        """Run the driver, whose files have a maximum size [bytes], and wait until it drives."""
        is_over, command = threading.Event(), [sys.executable, "-m", "lidarnaut.driver.drive", "--lidar-from-robot"]
        thread = threading.Thread(target=self.run, args=(is_over,), daemon=True)
        thread.start()
        with open(folder / "log.txt", "wb") as log:
            how = {"stdout": log, "stderr": log, "start_new_session": True}
            how["preexec_fn"] = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (max_size, max_size))
            program = subprocess.Popen([*command, "--url", self.recorder.url, *options], **how)
        try:
            while sum(map(any, self.recorder.commands[-30:])) < 10:
                assert program.poll() is None, (folder / "log.txt").read_text()
                time.sleep(0.05)
            yield program
        finally:
            if program.poll() is None:
                program.terminate()
                program.wait(60.0)
            is_over.set()
            thread.join()
            self.recorder.close()

    def wait_for_stop(self, since):
        """Return the time from `since` to the first stop after the last command that moves the robot [s]."""
        time.sleep(TIMEOUT + 2.0)
        moves = [at for at, v, w in self.recorder.timed_commands if v or w]
        return min(at for at, v, w in self.recorder.timed_commands if at > moves[-1]) - since


def load(folder):
    """4,000 x 4,000 cells, a disk that is full after 20 kB, and 3,000 messages per second."""
    image, middle = np.full((4000, 4000), 254, np.uint8), 2000
    image[[0, -1]] = image[:, [0, -1]] = image[middle - 40 : middle + 40, middle + 60] = 0
    Image.fromarray(image).save(folder / "map.png")
    numbers = "resolution: 0.05\norigin: [-100.0, -100.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (folder / "map.yaml").write_text(f"image: map.png\n{numbers}")
    robot = Robot(imu=60)
    known = "--map", str(folder / "map.yaml"), "--initial-pose", "0", "0", "0", "--goal", "50", "0"
    options = "--policy", "mppi", *known, "--imu-topic", "/imu", "--record", str(folder / "drive.mcap")
    with robot.driven(*options, folder=folder, max_size=20_000):
        begun, received = time.monotonic(), robot.sent
        time.sleep(20.0)
        times = np.array([at for at, *_ in robot.recorder.timed_commands if at > begun])
        sent = [each for each in robot.recorder.data if each["op"] == "publish"]
        received = (robot.sent - received) / 20.0
    text = (folder / "log.txt").read_text()
    maps = sum(each["topic"] == "/map" for each in sent)
    ended = next((line for line in text.splitlines() if "recording" in line), "the recording goes on")
    return f"longest gap {np.diff(times).max():.3f} s; {received:.0f} messages per second; maps {maps}; {ended}"


def lost(topic, folder):
    """Messages of a topic end."""
    robot = Robot()
    with robot.driven("--policy", "pursuit", folder=folder):
        time.sleep(1.0)
        robot.silent.add(topic)
        return f"stop after {robot.wait_for_stop(time.monotonic()):.3f} s"


def stopped(folder, whole_group=False):
    """SIGSTOP for ten seconds, of the driver or of all its processes."""
    robot = Robot()
    with robot.driven("--policy", "pursuit", folder=folder) as program:
        time.sleep(1.0)

        def kill(number):
            os.killpg(program.pid, number) if whole_group else os.kill(program.pid, number)

        since = time.monotonic()
        kill(signal.SIGSTOP)
        time.sleep(10.0)
        woken = time.monotonic()
        kill(signal.SIGCONT)
        time.sleep(4.0)
        during = [(at - since, v, w) for at, v, w in robot.recorder.timed_commands if since + 0.1 < at < woken]
        stop = next((f"{at:.3f} s" for at, v, w in during if v == w == 0.0), "never (no process runs)")
        after = [(v, w) for at, v, w in robot.recorder.timed_commands if at >= woken]
        first = "a stop" if after[0] == (0.0, 0.0) else f"{after[0]}"
        return f"stop after {stop}; first command after waking: {first}; drives again: {any(map(any, after))}"


def hour(folder, minutes=6.0):
    """Ten times real time, three cuts, a full disk."""
    robot = Robot(world="turtlebot3_house", speed=10.0)
    options = "--policy", "pursuit", "--use-sim-time", "--save-map", str(folder / "map.yaml")
    options += "--record", str(folder / "drive.mcap")
    with robot.driven(*options, folder=folder, max_size=10**7) as program:
        sizes, ends, began = [], time.monotonic() + 60.0 * minutes, time.monotonic()
        cuts = [began + 60.0 * minutes * part for part in (0.25, 0.5, 0.75)]
        while time.monotonic() < ends and program.poll() is None:
            status = Path(f"/proc/{program.pid}/status").read_text()
            sizes.append(int(status.partition("VmRSS:")[2].split()[0]) / 1024.0)
            if cuts and time.monotonic() > cuts[0]:
                cuts.pop(0)
                for socket in robot.recorder.sockets:
                    with contextlib.suppress(OSError):  # closed already
                        socket.socket.shutdown(2)
            time.sleep(1.0)
        simulated = robot.robot.time
        program.terminate()
        status = program.wait(60.0)
    part = np.array(sizes[len(sizes) // 3 :])
    growth = part[len(part) // 2 :].max() - part[: len(part) // 2].max()
    saved = (folder / "map.yaml").exists()
    return f"{simulated:.0f} simulated s; memory {growth:+.1f} MB (of {part.max():.0f}); map {saved}; status {status}"


SITUATIONS = {
    "load": load,
    "no scans": partial(lost, "/scan"),
    "no odometry": partial(lost, "/odom"),
    "driver stands still": stopped,
    "all processes stand still": partial(stopped, whole_group=True),
    "hour": hour,
}


def main(only: str = "", minutes: float = 6.0) -> None:
    """Print a line per situation. `only`: part of a situation's name; `minutes`: length of the long drive."""
    for name, run in SITUATIONS.items():
        if only in name:
            with tempfile.TemporaryDirectory() as folder:
                result = run(Path(folder), minutes) if name == "hour" else run(Path(folder))
            sys.stdout.write(f"{name:28}{result}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    run_command(main)
