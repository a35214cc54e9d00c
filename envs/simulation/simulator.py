"""What simulated robots report, and what every physics must offer."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from envs.geometry import Pose2D
from envs.robots import RobotParams
from envs.worlds import World

from .contact import Contact


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
    """What sensors of the user's own measured, by their names; see `envs.sensor.Sensor`."""

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


class Simulator(Protocol):
    """One or several equal robots in a world: they see each other, and collide with each other."""

    @property
    def ignored(self) -> tuple[str, ...]:
        """Parameters of robots that make no difference, as dotted names of attributes of `RobotParams`."""
        ...

    @property
    def robot(self) -> RobotParams:
        """The robots as they are: where parameters are drawn, those of this episode."""
        ...

    @property
    def rows(self) -> Any:
        """`envs.simulation.rows.Rows`: states, measurements and noise as arrays; see `BaseSimulator`."""
        ...

    @property
    def states(self) -> list[RobotState]:
        """Ground truth of each robot after the last `reset` or `step`."""
        ...

    @property
    def contacts(self) -> Sequence[Contact]:
        """What the robots touched during the last period, one entry for each thing."""
        ...

    @property
    def circles(self) -> np.ndarray:
        """Static cylinders, and after them what moves, now: shape (m, 3), float64, (x, y, radius), world frame [m]."""
        ...

    def set_robot(self, robot: RobotParams) -> None:
        """Change the robots' parameters from the next reset on; footprint and beams of the lidar stay as they were."""
        ...

    def reset(self, world: World, poses: Sequence[Pose2D], rngs: Sequence[np.random.Generator]) -> list[Reading]:
        """Place the robots at rest at poses in the world frame and return their first readings.

        All noise of a robot's episode is drawn from its own generator, so that it does not depend on the others':
        same generator state, same bytes.

        Raises:
            ValueError: a robot does not fit there, two of them overlap, or there are not as many poses and generators
                as robots.
        """
        ...

    def step(self, commands: Sequence[Twist]) -> list[Reading]:
        """Drive each robot with its commanded twist for one control period and return the readings at its end.

        Raises:
            ValueError: a command holds NaN or infinity, or there are not as many commands as robots.
            RuntimeError: there was no reset.
        """
        ...

    def move(self, commands: Sequence[Twist]) -> None:
        """Drive as `step` does; `rows` then hold what it returns. An environment calls this one."""
        ...

    def close(self) -> None:
        """Release what the simulator holds. Closing twice does no harm."""
        ...
