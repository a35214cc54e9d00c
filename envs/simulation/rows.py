"""Robots as rows of arrays: what kernels write, and what records of readings and states are made of when asked for."""

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import RobotParams

from . import records as at
from .sensors import OTHER_NORMALS

BLOCK = 16
"""Control periods for which noise is drawn at once."""


class Twist(NamedTuple):
    """Velocity of a differential-drive robot in its own frame."""

    v: float
    """Forward speed [m/s]."""
    w: float
    """Yaw rate, counter-clockwise [rad/s]."""


class Reading(NamedTuple):
    """Everything that a robot's sensors report at the end of one control period. Holds no ground truth."""

    time: float
    """Time since the reset [s]."""
    ranges: np.ndarray
    """Shape (num_beams,), float32 [m]: +inf where nothing lies within the lidar's range, NaN where the beam was
    dropped or hit something nearer than the least range (REP 117 has -inf for the latter)."""
    ticks: tuple[int, int]
    """Cumulative encoder counts of the left and the right wheel."""
    yaw_rate: float
    """Gyroscope: mean over the control period, as integrated by the robot's own controller [rad/s]."""
    heading: float
    """Compass, in the world frame [rad]; NaN for robots without one."""
    bumper: bool
    """Whether the body touched anything during the period."""
    extra: Mapping[str, np.ndarray] = {}
    """What sensors of the user's own measured, by their names; see `lidarnaut.envs.sensor.Sensor`."""

    @classmethod
    def of_scan(cls, ranges: np.ndarray, time: float = 0.0) -> "Reading":
        """Return a reading that holds a scan alone, shape (num_beams,), float32 [m]; for estimators without a robot."""
        return cls(time, ranges, (0, 0), 0.0, math.nan, False)


class RobotState(NamedTuple):
    """Ground truth of one robot. For metrics, rewards, `info` and tests; never for a policy."""

    pose: Pose2D
    """Pose of the robot's base (midpoint of the wheel axle) in the world frame."""
    twist: Twist
    """Velocity of the base."""


class Rows:
    """The numbers, scans and noise of several equal robots.

    All noise of a control period is drawn before the robots move: the order of draws depends neither on the physics
    nor on what the robots meet.
    """

    def __init__(self, robot: RobotParams, control_period: float, num_robots: int) -> None:
        num_beams, self._num_uniforms = robot.lidar.num_beams, 0
        self.numbers = np.zeros((num_robots, at.ROW_SIZE))
        """Shape (num_robots, ROW_SIZE), float64; see `records`."""
        self.ranges = np.empty((num_robots, num_beams), dtype=np.float32)
        """Scans, shape (num_robots, num_beams), float32 [m]."""
        self.draws = np.zeros((num_robots, BLOCK, OTHER_NORMALS + num_beams))
        """Noise, shape (num_robots, BLOCK, n): for a control period standard normal draws, see `SLIP_LEFT`, and one for
        each beam; then, once the lidar has had dropout, a uniform draw in [0, 1) for each beam."""
        self.memory: dict[Hashable, np.ndarray] = {}
        """What tasks and observation parts keep of an episode, by name: shape (num_robots, n) each; see `remember`."""
        self.set_robot(robot, control_period)
        self.reset()

    def remember(self, name: Hashable, size: int, dtype: Any = np.float64) -> np.ndarray:
        """Return the memory of this name, shape (num_robots, size), zeros at first; kernels get all of them at once."""
        if name not in self.memory:
            self.memory[name] = np.zeros((len(self.numbers), size), dtype)
        return self.memory[name]

    def set_robot(self, robot: RobotParams, control_period: float) -> None:
        """Change the robots' parameters; the number of beams stays as it was."""
        self.numbers[:, at.ROBOT :] = at.robot_record(robot, control_period)
        if robot.lidar.dropout > 0.0 and not self._num_uniforms:
            self._num_uniforms = robot.lidar.num_beams
            self.draws = np.zeros((len(self.draws), BLOCK, OTHER_NORMALS + 2 * self._num_uniforms))

    def reset(self) -> None:
        """Begin an episode: everything is zero, and no noise is left."""
        self.numbers[:, : at.SETUP] = 0.0
        self.numbers[:, at.DRAW] = BLOCK - 1

    def draw(self, rngs: Sequence[np.random.Generator]) -> None:
        """Draw the noise of one scan, each robot's from its own generator."""
        self.draw_ahead(rngs, 1)
        self.numbers[:, at.DRAW] += 1.0

    def draw_ahead(self, rngs: Sequence[np.random.Generator], count: int = BLOCK) -> None:
        """Draw the noise of so many control periods if what was drawn before is used up."""
        if self.numbers[0, at.DRAW] == BLOCK - 1:
            for rng, block in zip(rngs, self.draws, strict=True):
                self._draw(rng, block[BLOCK - count :])
            self.numbers[:, at.DRAW] = BLOCK - 1 - count

    def _draw(self, rng: np.random.Generator, rows: np.ndarray) -> None:
        if not self._num_uniforms:
            rng.standard_normal(out=rows)
            return
        for row in rows:
            rng.standard_normal(out=row[: -self._num_uniforms])
            rng.random(out=row[-self._num_uniforms :])

    @property
    def steps(self) -> int:
        """Control periods since the reset."""
        return int(self.numbers[0, at.STEPS])

    def tick(self) -> None:
        """Begin a control period, with a row of noise of its own; `step_robots` does the same."""
        self.go_to(self.steps + 1)
        self.numbers[:, at.DRAW] += 1.0

    def go_to(self, steps: int) -> None:
        """Set the number of control periods since the reset, and the time."""
        self.numbers[:, at.STEPS], self.numbers[:, at.TIME] = steps, steps * self.numbers[0, at.PERIOD]

    def state(self, k: int) -> RobotState:
        """Return the ground truth of a robot."""
        x, y, theta, *_, v, w = self.numbers[k, : at.W + 1].tolist()
        return RobotState(Pose2D(x, y, theta), Twist(v, w))

    def reading(self, k: int) -> Reading:
        """Return the measurements of a robot in fresh arrays."""
        left, right, yaw_rate, heading, touched, _, time = self.numbers[k, at.LEFT_TICKS : at.TIME + 1].tolist()
        return Reading(time, self.ranges[k].copy(), (int(left), int(right)), yaw_rate, heading, touched > 0.0)

    def share(
        self, numbers: np.ndarray, ranges: np.ndarray, draws: np.ndarray, memory: Mapping[Hashable, np.ndarray]
    ) -> None:
        """Move to rows of larger arrays, which kernels step together."""
        for key, kept in memory.items():
            kept[...] = self.memory[key]
        self.memory = {**self.memory, **memory}
        for name, rows in (("numbers", numbers), ("ranges", ranges), ("draws", draws)):
            rows[...] = getattr(self, name)
            setattr(self, name, rows)
