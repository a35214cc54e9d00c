"""Episodes of a simulated robot that is driven by messages of several rates and delays."""

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from lidarnaut.agents.policies import make_policy
from lidarnaut.baselines.episode import run_episode
from lidarnaut.benchmarks.drives.recording import PERIOD, Row, run_each
from lidarnaut.driver import Driver
from lidarnaut.driver.simulated_robot import SimulatedRobot
from lidarnaut.envs.command_line import Count
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.tasks.coverage import Coverage

WORLD, ROBOT, EXPLORER, TARGET, MAX_TIME = "turtlebot3_house", "turtlebot3_burger", "pursuit", 0.95, 900.0


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
        self.command, self.reasons, self.contacts, self.processor_time = Twist(0.0, 0.0), list[str](), 0, 0.0
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
            began = time.process_time()
            for _, kind, content, stamp in arrived:
                (driver.odometry if kind == "odometry" else partial(driver.scan, delays=delays))(content, stamp)
            is_due = now >= self._next_command - 1e-9
            if is_due:
                self._next_command += PERIOD
                self.command = driver.command(now + self.offset)
                self.reasons.append(driver.reason)
            self.processor_time += time.process_time() - began
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


def _explore(link: str, seed: int) -> dict[str, float]:
    robot = SimulatedRobot(WORLD, ROBOT, seed=seed)
    loop = Loop(Driver(make_policy(EXPLORER), ROBOT, seed=seed), robot, LINKS[link], seed)
    coverage = Coverage(robot.area, robot.start, robot.robot.lidar)

    def watch() -> bool:
        if loop.driver.has_begun:
            belief = loop.driver.belief
            coverage.update(belief.update, belief.grid.resolution, loop.driver.env.reading.ranges, robot.pose)
        return coverage.explored_fraction >= TARGET

    reached = loop.run(MAX_TIME, watch)
    costs = {"contacts": loop.contacts, "error": loop.error, "load": loop.processor_time / robot.time}
    return {"time": robot.time if reached else math.inf, **costs}


def _explore_in_environment(seed: int) -> dict[str, float]:
    start = tuple(SimulatedRobot(WORLD, ROBOT, seed=seed).start)
    arguments: dict[str, Any] = {"world": WORLD, "robot": ROBOT, "physics": "kinematic", "start": start}
    env = gymnasium.make("lidarnaut/Explore-v0", target_coverage=TARGET, time_limit=MAX_TIME, **arguments)
    episode = run_episode(env, make_policy(EXPLORER), seed)
    env.close()
    return {"time": episode.time_to_95, "contacts": episode.collisions, "error": episode.position_rmse}


def compare_driving(starts: Count = 20, jobs: Count = 1) -> list[Row]:
    """Compare exploration through a `Driver`, with messages of several rates and delays, with that in an environment.

    Args:
        starts: number of start poses in `turtlebot3_house`.
        jobs: number of worker processes.
    """
    seeds = [(seed,) for seed in range(starts)]
    reference = run_each(_explore_in_environment, seeds, jobs, "environment")
    found = {"environment": reference}
    found |= {link: run_each(partial(_explore, link), seeds, jobs, link) for link in LINKS}
    return [{"policy": EXPLORER, "messages": name, **_summary(some, reference)} for name, some in found.items()]


def _summary(episodes: list[dict[str, float]], reference: list[dict[str, float]]) -> Row:
    ratios = [math.log(one["time"] / other["time"]) for one, other in zip(episodes, reference, strict=True)]
    return {
        "time / environment's": math.exp(float(np.mean(ratios))),
        "worst": math.exp(max(ratios)),
        "time to 95 % s": float(np.mean([one["time"] for one in episodes])),
        "contacts": int(sum(one["contacts"] for one in episodes)),
        "position error m": float(np.mean([one["error"] for one in episodes])),
        "load of a core %": 100.0 * float(np.mean([one.get("load", math.nan) for one in episodes])),
    }
