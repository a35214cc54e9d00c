"""Base classes of movers, which move the robots of an environment and measure, and of the physics engines."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import gymnasium
import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.worlds import World

from .contact import Contact, check_starts, find_contacts
from .crowd import Crowd, People
from .crowd import person_row as crowd_at
from .crowd.step import with_people
from .rows import Reading, RobotState, Rows, Twist
from .sensors import SLIP_LEFT, sense
from .spinning_lidar import SpinningLidar


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


class Simulator(Mover):
    """Base class of physics engines that simulate identical robots in a world."""

    deskews = True
    """Whether scans of a lidar that spins are corrected for the robot's motion, by odometry."""
    _world: World | None = None

    def set_robot(self, robot: RobotParams) -> None:
        super().set_robot(robot)
        self._spinning = SpinningLidar(robot.lidar, self._period)

    @property
    def states(self) -> list[RobotState]:
        """True pose and velocity of each robot."""
        self._reset_world()
        return [self.rows.state(k) for k in range(len(self.rows.numbers))]

    @property
    def contacts(self) -> list[Contact]:
        """Contacts during the last control period, one per touched object."""
        return find_contacts(self.rows.numbers, self._reset_world(), self.crowd.rows)

    def reset(
        self,
        world: World,
        poses: Sequence[Pose2D],
        rngs: Sequence[np.random.Generator],
        crowd_rng: np.random.Generator | None = None,
    ) -> list[Reading]:
        """Place the robots at rest and return their first sensor readings.

        `poses`: start poses, world frame. `rngs`, `crowd_rng`: random generators of each robot's noise and of the
        crowd.

        Raises:
            ValueError: robots or people do not fit or overlap, or a list has the wrong length.
        """
        self._check_number(poses=poses, rngs=rngs)
        check_starts(poses, self.robot.radius, world)
        self._world, self.rngs, rows = world, rngs, self.rows
        self.crowd.reset(world, poses, self.robot.radius, crowd_rng)
        rows.reset()
        self._place(world, poses)
        rows.draw(rngs)
        # The draw for wheel slip is unused at a reset and determines the gyroscope bias.
        rows.numbers["gyro_bias"] = self.robot.imu.gyro_bias_std * rows.draws[:, -1, SLIP_LEFT]
        self.sense()
        self._spin(world)
        return self._readings()

    def step(self, commands: Sequence[Twist]) -> list[Reading]:
        """Move the robots by one control period and return their sensor readings.

        `commands`: twist (v, w) of each robot [m/s, rad/s].

        Raises:
            ValueError: a command is not finite, or the number of commands is wrong.
            gymnasium.error.ResetNeeded: `reset` was not called.
        """
        self._reset_world()
        self._check_number(commands=commands)
        for v, w in commands:
            if not np.isfinite([v, w]).all():
                raise ValueError(f"command must be finite, got v = {v} m/s, w = {w} rad/s")
        self.rows.numbers["command"] = commands
        self.rows.draw_ahead(self.rngs, 1)
        self.move()
        return self._readings()

    def move(self) -> None:
        world, rows = self._reset_world(), self.rows
        rows.draw_ahead(self.rngs)
        self._move(world)
        self._spin(world)

    @abstractmethod
    def _place(self, world: World, poses: Sequence[Pose2D]) -> None:
        """Place the robots at rest at their start poses."""

    @abstractmethod
    def _move(self, world: World) -> None:
        """Move people and robots by one control period, and simulate the sensors."""

    def sense(self) -> None:
        rows, world = self.rows, self._reset_world()
        sense(rows.numbers, rows.draws, rows.ranges, world.segments, self._visible_circles(world), world.magnets)

    def _spin(self, world: World) -> None:
        if self.robot.lidar.scan_time:
            self._spinning.measure(self.rows, world.segments, self._visible_circles(world), deskews=self.deskews)

    def _visible_circles(self, world: World) -> np.ndarray:
        visible: np.ndarray = with_people(world.circles, self.crowd.rows, self.crowd.setup[crowd_at.LEGS])
        return visible

    def _reset_world(self) -> World:
        if self._world is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        return self._world

    def _check_number(self, **arguments: Sequence[Any]) -> None:
        count = len(self.rows.numbers)
        for name, values in arguments.items():
            if len(values) != count:
                raise ValueError(f"{name} must have one entry per robot, {count} in all, got {len(values)}")
