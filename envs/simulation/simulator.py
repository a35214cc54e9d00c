"""What a simulated robot reports, and what every physics must offer."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from envs.geometry import Pose2D
from envs.worlds import World


class Twist(NamedTuple):
    """Velocity of a differential-drive robot in its own frame."""

    v: float
    """Forward speed [m/s]."""
    w: float
    """Yaw rate, counter-clockwise [rad/s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Everything the robot's sensors say at the end of one control period. Holds no truth."""

    time: float
    """Time since the reset [s]."""
    ranges: np.ndarray
    """Shape (num_beams,), float32 [m]: +inf where nothing lies within the lidar's range, NaN where the beam was
    dropped or hit something nearer than the least range (REP 117 has -inf for the latter)."""
    ticks: tuple[int, int]
    """Cumulative encoder counts of the left and the right wheel."""
    yaw_rate: float
    """Gyroscope [rad/s]."""
    heading: float
    """Compass, in the world frame [rad]; NaN for robots without one."""
    bumper: bool
    """Whether the body touched anything during the period."""


class TrueState(NamedTuple):
    """The truth about the robot. For metrics, rewards, `info` and tests; never for a policy."""

    pose: Pose2D
    """Pose of the robot's base (midpoint of the wheel axle) in the world frame."""
    twist: Twist
    """Velocity of the base."""


class Simulator(Protocol):
    """A robot in a world. Constructed as `Simulator(robot, control_period=..., ...)`."""

    @property
    def state(self) -> TrueState:
        """The truth after the last `reset` or `step`."""
        ...

    def reset(self, world: World, pose: Pose2D, rng: np.random.Generator) -> Reading:
        """Put the robot at rest at `pose` (world frame) and return its first reading.

        All noise of the episode is drawn from `rng`: same generator state, same bytes.
        """
        ...

    def step(self, command: Twist) -> Reading:
        """Drive with the commanded twist for one control period and return what the sensors say at its end."""
        ...

    def close(self) -> None:
        """Release what the simulator holds. Closing twice does no harm."""
        ...
