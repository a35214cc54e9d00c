"""Base class of movers, which move the robots of an environment and measure."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.worlds import World

from .crowd import Crowd, People
from .rows import Reading, Rows


class Mover(ABC):
    """Base class of physics engines, of slides along planned paths, and of messages of a real robot.

    A mover moves all robots of an environment by one control period, and writes their measurements into `rows`.
    """

    ignored: tuple[str, ...] = ()
    """Robot parameters without effect, as dotted attribute names of `RobotParams`."""
    ignores: Mapping[str, str] = MappingProxyType({})
    """Arguments of environments that the mover cannot honour, and that are refused: what honours each."""

    def __init__(
        self, robot: RobotParams, control_period: float, num_robots: int = 1, crowd: Crowd | None = None
    ) -> None:
        self.rows = Rows(robot, control_period, num_robots)
        self.rngs: Sequence[np.random.Generator] = ()
        self.crowd = People(crowd)
        self._period = float(control_period)
        self.set_robot(robot)

    def set_robot(self, robot: RobotParams) -> None:
        """Change the robot parameters from the next reset on, except footprint and lidar beams."""
        self.robot = robot
        self.rows.set_robot(robot, self._period)

    @property
    def people(self) -> np.ndarray:
        """True states of people, shape (n, 5), float64: x, y [m], vx, vy [m/s], radius [m], world frame."""
        return self.crowd.states

    @abstractmethod
    def reset(
        self,
        world: World,
        poses: Sequence[Pose2D],
        rngs: Sequence[np.random.Generator],
        crowd_rng: np.random.Generator | None = None,
    ) -> list[Reading]:
        """Start an episode, and return the first sensor readings; see `Simulator.reset`."""

    @abstractmethod
    def move(self) -> None:
        """Move the robots by one control period, by the commands in `rows`; write measurements into `rows`."""

    def close(self) -> None:  # noqa: B027
        """Release resources. Repeated calls have no effect."""

    def _readings(self) -> list[Reading]:
        return [self.rows.reading(k) for k in range(len(self.rows.numbers))]
