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
from pathlib import Path

import numpy as np
from PIL import Image

from lidarnaut.driver.simulated_robot import SimulatedRobot
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.logs import messages
from lidarnaut.envs.simulation import Twist

from .recorder import Recorder

TIMEOUT = 1.0


class Robot:
    """Simulated robot behind a server, with odometry at 50 Hz and scans at 10 Hz."""

    def __init__(self, world="turtlebot3_world", speed=1.0, imu=0):
        self.server = Recorder()
        self.robot = SimulatedRobot(world, "turtlebot3_burger", start="spawn")
        self.speed, self.imu, self.silent, self.sent, self.is_over = speed, imu, set(), 0, False
        self._thread = threading.Thread(target=self._simulate, daemon=True)
        self._thread.start()

    def _publish(self, topic, message):
        if topic not in self.silent:
            self.sent += 1
            self.server.publish(topic, message)

    def _simulate(self):
        began, offset, k = time.monotonic(), 1000.0, 0
        lidar = self.robot.robot.lidar
        while not self.is_over:
            now = offset + self.robot.time
            self._publish("/clock", messages.clock(now))
            self._publish("/odom", messages.odometry(now, self.robot.odometry, self.robot.twist))
            for part in range(self.imu):
                self._publish("/imu", messages.imu(now + 0.02 * part / self.imu, self.robot.reading.yaw_rate))
            if k % 5 == 0:
                ranges = np.nan_to_num(self.robot.reading.ranges, nan=0.0, posinf=lidar.range_max + 1.0)
                self._publish("/scan", messages.laser_scan(now, ranges, lidar, 0.1))
            commands = self.server.timed_commands[-1:]
            is_fresh = commands and time.monotonic() - commands[0][0] < 0.5
            self.robot.step(Twist(*commands[0][1:]) if is_fresh else Twist(0.0, 0.0))
            k += 1
            time.sleep(max(0.0, began + 0.02 * k / self.speed - time.monotonic()))

    @contextlib.contextmanager
    def driven(self, *options, folder, **how):
        """Run the driver, and wait until it drives."""
        command = [sys.executable, "-m", "lidarnaut.driver.drive", "--url", self.server.url, *options]
        with open(folder / "log.txt", "wb") as log:
            program = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True, **how)
        try:
            while sum(map(any, self.server.commands[-30:])) < 10:
                assert program.poll() is None, (folder / "log.txt").read_text()
                time.sleep(0.05)
            yield program
        finally:
            if program.poll() is None:
                program.send_signal(signal.SIGTERM)
                program.wait(60.0)
            self.is_over = True
            self._thread.join()
            self.server.close()

    def wait_for_stop(self, since):
        """Return the time from `since` to the first stop after the last command that moves the robot [s]."""
        time.sleep(TIMEOUT + 2.0)
        moves = [at for at, v, w in self.server.timed_commands if v or w]
        return min(at for at, v, w in self.server.timed_commands if at > moves[-1]) - since


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

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    with robot.driven(*options, folder=folder, preexec_fn=limit):
        begun, received = time.monotonic(), robot.sent
        time.sleep(20.0)
        times = np.array([at for at, *_ in robot.server.timed_commands if at > begun])
        sent = [each for each in robot.server.data if each["op"] == "publish"]
        received = (robot.sent - received) / 20.0
    text = (folder / "log.txt").read_text()
    maps = sum(each["topic"] == "/map" for each in sent)
    ended = next((line for line in text.splitlines() if "recording" in line), "the recording goes on")
    return f"longest gap {np.diff(times).max():.3f} s; {received:.0f} messages per second; maps {maps}; {ended}"


def lost(topic):
    """Messages of a topic end."""

    def run(folder):
        robot = Robot()
        with robot.driven("--policy", "pursuit", folder=folder):
            time.sleep(1.0)
            robot.silent.add(topic)
            return f"stop after {robot.wait_for_stop(time.monotonic()):.3f} s"

    return run


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
        during = [(at - since, v, w) for at, v, w in robot.server.timed_commands if since + 0.1 < at < woken]
        stop = next((f"{at:.3f} s" for at, v, w in during if v == w == 0.0), "never (no process runs)")
        after = [(v, w) for at, v, w in robot.server.timed_commands if at >= woken]
        first = "a stop" if after[0] == (0.0, 0.0) else f"{after[0]}"
        return f"stop after {stop}; first command after waking: {first}; drives again: {any(map(any, after))}"


def hour(folder, minutes=6.0):
    """Ten times real time, three cuts, a full disk."""
    robot = Robot("turtlebot3_house", speed=10.0)
    options = "--policy", "pursuit", "--use-sim-time", "--save-map", str(folder / "map.yaml")
    options += "--record", str(folder / "drive.mcap")

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (10**7, 10**7))

    with robot.driven(*options, folder=folder, preexec_fn=limit) as program:
        sizes, ends, began = [], time.monotonic() + 60.0 * minutes, time.monotonic()
        cuts = [began + 60.0 * minutes * part for part in (0.25, 0.5, 0.75)]
        while time.monotonic() < ends and program.poll() is None:
            status = Path(f"/proc/{program.pid}/status").read_text()
            sizes.append(int(status.partition("VmRSS:")[2].split()[0]) / 1024.0)
            if cuts and time.monotonic() > cuts[0]:
                cuts.pop(0)
                for socket in robot.server.sockets:
                    with contextlib.suppress(OSError):  # closed already
                        socket.socket.shutdown(2)
            time.sleep(1.0)
        simulated = robot.robot.time
        program.send_signal(signal.SIGTERM) if program.poll() is None else None
        status = program.wait(60.0)
    part = np.array(sizes[len(sizes) // 3 :])
    growth = part[len(part) // 2 :].max() - part[: len(part) // 2].max()
    saved = (folder / "map.yaml").exists()
    return f"{simulated:.0f} simulated s; memory {growth:+.1f} MB (of {part.max():.0f}); map {saved}; status {status}"


SITUATIONS = {
    "load": load,
    "no scans": lost("/scan"),
    "no odometry": lost("/odom"),
    "driver stands still": stopped,
    "all processes stand still": lambda folder: stopped(folder, whole_group=True),
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
