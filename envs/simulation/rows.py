"""Records, scans and random numbers of robots, stored in arrays."""

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.geometry import ORIGIN, Pose2D
from lidarnaut.envs.robots import RobotParams

from . import records as at
from .sensors import OTHER_NORMALS

BLOCK = 16
"""Number of control periods whose noise is sampled at once."""
_MEASURED = "left_ticks", "right_ticks", "yaw_rate", "heading", "touched", "time", "odometry", "odometry_pose"


class Twist(NamedTuple):
    """Velocity of a differential-drive robot in its base frame."""

    v: float
    """Forward speed [m/s]."""
    w: float
    """Yaw rate, counter-clockwise [rad/s]."""


class Reading(NamedTuple):
    """Sensor measurements of a robot, without ground truth."""

    time: float
    """Time since the reset [s]."""
    ranges: np.ndarray
    """Lidar ranges, shape (num_beams,), float32 [m]: +inf beyond the maximum range, NaN for dropped beams, below the
    minimum range, or in the gap of a lidar that spins."""
    ticks: tuple[int, int]
    """Cumulative encoder counts of the left and right wheel."""
    yaw_rate: float
    """Mean yaw rate over the control period, measured by the gyroscope [rad/s]."""
    heading: float
    """Compass heading in the world frame [rad]; NaN without a compass."""
    bumper: bool
    """Whether the body touched anything during the control period."""
    motion: Pose2D = ORIGIN
    """Base pose by odometry, relative to the base pose at the last control period [m, m, rad]."""
    odometry: Pose2D = ORIGIN
    """Base pose by odometry, relative to the base pose at the reset [m, m, rad]."""
    extra: Mapping[str, np.ndarray] = {}
    """Measurements of user-defined sensors by name; see `lidarnaut.envs.sensor.Sensor`."""

    def motion_since(self, odometry: Pose2D) -> Pose2D:
        """Return the base pose relative to that of an earlier reading with this `odometry` [m, m, rad]."""
        is_last = odometry.compose(self.motion) == self.odometry  # the difference of poses would be rounded
        return self.motion if is_last else odometry.between(self.odometry)

    @classmethod
    def of_scan(cls, ranges: np.ndarray, time: float = 0.0) -> "Reading":
        """Create sensor measurements of a robot with only a lidar; other sensors measure 0 or NaN.

        `ranges`: shape (num_beams,), float32 [m].
        """
        return cls(time, ranges, (0, 0), 0.0, math.nan, False)


class RobotState(NamedTuple):
    """True pose and velocity of a robot."""

    pose: Pose2D
    """Pose of the robot's base in the world frame."""
    twist: Twist
    """Velocity (v, w) of the base in its own frame [m/s, rad/s]."""


class Rows:
    """Records, lidar scans and random numbers of identical robots, one array row per robot."""

    def __init__(self, robot: RobotParams, control_period: float, num_robots: int) -> None:
        num_beams, self._num_uniforms = robot.lidar.num_beams, 0
        self.numbers = np.zeros(num_robots, at.ROW)
        """Records of the robots, shape (num_robots,), dtype `ROW`; see module `records`."""
        self.ranges = np.empty((num_robots, num_beams), dtype=np.float32)
        """Lidar ranges, shape (num_robots, num_beams), float32 [m]."""
        self.draws = np.zeros((num_robots, BLOCK, OTHER_NORMALS + num_beams))
        """Random numbers for motion and sensor noise, shape (num_robots, BLOCK, n), float64.

        Each control period uses n numbers: standard normal numbers for wheel slip (2), gyroscope, compass and each
        beam; with lidar dropout, also a uniform number in [0, 1) per beam."""
        self.memory: dict[Hashable, np.ndarray] = {}
        """Data that tasks and observations store from step to step: arrays by name, shape (num_robots, n) each."""
        self.numbers["odometry_settings"] = at.OdometrySettings.of(robot)
        self.set_robot(robot, control_period)
        self.reset()

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, numbers=state["numbers"].view(at.ROW))  # kernels compare other dtypes by field

    def remember(self, name: Hashable, size: int, dtype: Any = np.float64) -> np.ndarray:
        """Return the data that a task or observation stores as `name`, shape (num_robots, size); zeros at first."""
        if name not in self.memory:
            self.memory[name] = np.zeros((len(self.numbers), size), dtype)
        return self.memory[name]

    def set_robot(self, robot: RobotParams, control_period: float) -> None:
        numbers, (radius, *others, period, substeps) = self.numbers, at.robot_record(robot, control_period)
        numbers["radius"], numbers["robot"], numbers["period"], numbers["substeps"] = radius, others, period, substeps
        if robot.lidar.dropout > 0.0 and not self._num_uniforms:
            self._num_uniforms = robot.lidar.num_beams
            self.draws = np.zeros((len(self.draws), BLOCK, OTHER_NORMALS + 2 * self._num_uniforms))

    def reset(self) -> None:
        self.numbers.view(np.float64).reshape(len(self.numbers), -1)[:, : at.NUM_RESET] = 0.0
        self.numbers["draw"] = BLOCK - 1

    def draw(self, rngs: Sequence[np.random.Generator]) -> None:
        """Sample the noise of one control period, with one random generator per robot."""
        self.draw_ahead(rngs, 1)
        self.numbers["draw"] += 1.0

    def draw_ahead(self, rngs: Sequence[np.random.Generator], count: int = BLOCK) -> None:
        """Sample the noise of the next `count` control periods if no sampled noise is left."""
        if self.numbers["draw"][0] == BLOCK - 1:
            for rng, block in zip(rngs, self.draws, strict=True):
                if not self._num_uniforms:
                    rng.standard_normal(out=block[BLOCK - count :])
                    continue
                for row in block[BLOCK - count :]:
                    rng.standard_normal(out=row[: -self._num_uniforms])
                    rng.random(out=row[-self._num_uniforms :])
            self.numbers["draw"] = BLOCK - 1 - count

    @property
    def steps(self) -> int:
        return int(self.numbers["steps"][0])

    def tick(self) -> None:
        self.go_to(self.steps + 1)
        self.numbers["draw"] += 1.0

    def go_to(self, steps: int) -> None:
        self.numbers["steps"], self.numbers["time"] = steps, steps * self.numbers["period"][0]

    def state(self, k: int) -> RobotState:
        x, y, theta, v, w = (float(self.numbers[name][k]) for name in ("x", "y", "theta", "v", "w"))
        return RobotState(Pose2D(x, y, theta), Twist(v, w))

    def reading(self, k: int) -> Reading:
        left, right, yaw_rate, heading, touched, time, *poses = (self.numbers[name][k].tolist() for name in _MEASURED)
        motion, odometry = (Pose2D(*pose) for pose in poses)
        ticks = int(left), int(right)
        return Reading(time, self.ranges[k].copy(), ticks, yaw_rate, heading, touched > 0.0, motion, odometry)

    def share(
        self, numbers: np.ndarray, ranges: np.ndarray, draws: np.ndarray, memory: Mapping[Hashable, np.ndarray]
    ) -> None:
        """Move all arrays into slices of larger arrays, which hold the robots of many environments."""
        for key, kept in memory.items():
            kept[...] = self.memory[key]
        self.memory = {**self.memory, **memory}
        for name, rows in (("numbers", numbers), ("ranges", ranges), ("draws", draws)):
            rows[...] = getattr(self, name)
            setattr(self, name, rows)
