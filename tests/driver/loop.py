"""Simulated robot that is driven by messages of several rates and delays."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.driver import Driver
from lidarnaut.driver.simulated_robot import SimulatedRobot
from lidarnaut.envs.simulation import Twist

PERIOD = 0.1
"""Time between commands [s]."""


class Link(NamedTuple):
    """Rates and delays of messages, which arrive in order."""

    scan_hz: float = 10.0
    odometry_delay: float = 0.0
    scan_delay: float = 0.0
    jitter: float = 0.0
    """Standard deviation of further delays [s]."""


IDEAL = Link()
LINKS = {
    "odometry 50 Hz, scans 10 Hz": IDEAL,
    "scans 5 Hz": Link(scan_hz=5.0),
    "scans 40 Hz, jitter 10 ms": Link(scan_hz=40.0, jitter=0.01),
    "scans 0.1 s late, odometry 0.02 s, jitter 10 ms": Link(odometry_delay=0.02, scan_delay=0.1, jitter=0.01),
    "scans 5 Hz and 0.2 s late, odometry 0.05 s, jitter 10 ms": Link(5.0, 0.05, 0.2, 0.01),
}


class Loop:
    """Simulated robot and driver, joined by messages."""

    def __init__(self, driver: Driver, robot: SimulatedRobot, link: Link = IDEAL, seed: int = 0) -> None:
        self.driver, self.robot, self.link = driver, robot, link
        self.rng = np.random.default_rng(seed)
        self.command, self.reasons, self.contacts = Twist(0.0, 0.0), list[str](), 0
        self.silent, self.offset = set[str](), 0.0
        """Kinds of messages that are lost, `scan` and `odometry`; difference between the clocks of messages and of the
        simulation [s]."""
        self._pending: list[tuple[float, str, Any, float]] = []
        self._latest = {"scan": 0.0, "odometry": 0.0}
        self._next_scan = self._next_command = robot.time
        self._touched = False

    def run(self, seconds: float, watch: Callable[[], bool] = lambda: False) -> bool:
        """Simulate for a time [s], or until `watch`, called after each command, returns True; return that value."""
        robot, driver, end, lidar = self.robot, self.driver, self.robot.time + seconds, self.robot.robot.lidar
        delays = lidar.time_increment * np.arange(1 - lidar.num_beams, 1)  # a scan ends when it is sent
        while robot.time < end - 1e-9:
            now = robot.time
            self._send("odometry", tuple(robot.odometry), self.link.odometry_delay)
            if now >= self._next_scan - 1e-9:
                self._next_scan += 1.0 / self.link.scan_hz
                self._send("scan", robot.reading.ranges, self.link.scan_delay)
            arrived = sorted((one for one in self._pending if one[0] <= now + 1e-9), key=lambda one: (one[0], one[3]))
            self._pending = [each for each in self._pending if each[0] > now + 1e-9]
            for _, kind, content, stamp in arrived:
                (driver.odometry if kind == "odometry" else partial(driver.scan, delays=delays))(content, stamp)
            is_due = now >= self._next_command - 1e-9
            if is_due:
                self._next_command += PERIOD
                self.command = driver.command(now + self.offset)
                self.reasons.append(driver.reason)
            if is_due and watch():
                return True
            touches = robot.step(self.command).bumper
            self.contacts += touches and not self._touched
            self._touched = touches
        return False

    def _send(self, kind: str, content: Any, delay: float) -> None:
        now, jitter = self.robot.time, abs(float(self.rng.normal(0.0, self.link.jitter)))
        self._latest[kind] = max(self._latest[kind], now + delay + jitter)
        if kind not in self.silent:
            self._pending.append((self._latest[kind], kind, content, now + self.offset))

    @property
    def error(self) -> float:
        """Distance between estimated and true position [m]."""
        return math.dist(self.robot.start.compose(self.driver.belief.pose)[:2], self.robot.pose[:2])
