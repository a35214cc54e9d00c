"""One or several equal robots in a world, whatever moves them."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.worlds import World

from .contact import Contact, check_starts, find_contacts
from .crowd import Crowd, People
from .crowd.step import with_bodies
from .records import COMMAND_V, COMMAND_W, GYRO_BIAS
from .rows import BLOCK, Reading, RobotState, Rows, Twist
from .sensors import SLIP_LEFT, sense


class Simulator(ABC):
    """Robots that see each other and collide with each other; physics are subclasses."""

    ignored: tuple[str, ...] = ()
    """Parameters of robots that make no difference, as dotted names of attributes of `RobotParams`."""

    def __init__(
        self, robot: RobotParams, control_period: float, num_robots: int = 1, crowd: Crowd | None = None
    ) -> None:
        self.rows = Rows(robot, control_period, num_robots)
        """The robots' states, measurements and noise."""
        self.rngs: Sequence[np.random.Generator] = ()
        self.crowd = People(crowd)
        """The people of the episode, as kernels see them."""
        self.robot = robot
        """The robots as they are: where parameters are drawn, those of this episode."""
        self._radius, self._period = robot.radius, float(control_period)
        self._world: World | None = None

    def set_robot(self, robot: RobotParams) -> None:
        """Change the robots' parameters from the next reset on; footprint and beams of the lidar stay as they were."""
        self.robot = robot
        self.rows.set_robot(robot, self._period)

    @property
    def states(self) -> list[RobotState]:
        """Ground truth of each robot after the last `reset` or `step`."""
        self._reset_world()
        return [self.rows.state(k) for k in range(len(self.rows.numbers))]

    @property
    def contacts(self) -> list[Contact]:
        """What the robots touched during the last period, one entry for each thing."""
        return find_contacts(self.rows.numbers, self._reset_world(), self.crowd.rows)

    @property
    def people(self) -> np.ndarray:
        """Ground truth of people: shape (n, 5), float64, x, y, radius [m], vx, vy [m/s], world frame."""
        return self.crowd.states

    def reset(
        self,
        world: World,
        poses: Sequence[Pose2D],
        rngs: Sequence[np.random.Generator],
        crowd_rng: np.random.Generator | None = None,
    ) -> list[Reading]:
        """Place the robots at rest at poses in the world frame and return their first readings.

        All noise of a robot's episode is drawn from its own generator, so that it does not depend on the others':
        same generator state, same bytes. People are drawn from `crowd_rng`, which a crowd needs.

        Raises:
            ValueError: a robot does not fit there, two of them overlap, there is no room for all people, or there are
                not as many poses and generators as robots.
        """
        self._check_number(poses=poses, rngs=rngs)
        check_starts(poses, self._radius, world)
        self._world, self.rngs, rows = world, rngs, self.rows
        self.crowd.reset(world, poses, self._radius, crowd_rng)
        rows.reset()
        self._place(world, poses)
        rows.draw(rngs)
        # The bias of an episode is by the draw that slip leaves unused at a reset.
        rows.numbers[:, GYRO_BIAS] = self.robot.imu.gyro_bias_std * rows.draws[:, -1, SLIP_LEFT]
        self.sense()
        return self._readings()

    def step(self, commands: Sequence[Twist]) -> list[Reading]:
        """Drive each robot with its command for one control period and return the readings at its end.

        Raises:
            ValueError: a command holds NaN or infinity, or there are not as many commands as robots.
            gymnasium.error.ResetNeeded: there was no reset.
        """
        self.move(commands, 1)
        return self._readings()

    def move(self, commands: Sequence[Twist], ahead: int = BLOCK) -> None:
        """Drive as `step` does; `rows` then hold what it returns. An environment calls this one.

        `ahead`: control periods for which noise is drawn at once, which nobody else may draw from the generators.
        """
        world, rows = self._reset_world(), self.rows
        self._check_number(commands=commands)
        for k, (v, w) in enumerate(commands):
            if not (math.isfinite(v) and math.isfinite(w)):
                raise ValueError(f"command must be finite, got v = {v} m/s, w = {w} rad/s")
            rows.numbers[k, COMMAND_V], rows.numbers[k, COMMAND_W] = v, w
        rows.draw_ahead(self.rngs, ahead)
        self._move(world)

    def close(self) -> None:  # noqa: B027
        """Release what the simulator holds. Closing twice does no harm."""

    @abstractmethod
    def _place(self, world: World, poses: Sequence[Pose2D]) -> None:
        """Put the robots at rest at their poses, and write these to `rows`."""

    @abstractmethod
    def _move(self, world: World) -> None:
        """Let people walk and drive all robots, by the commands in `rows`, for one control period; then `sense`."""

    def sense(self) -> None:
        """Measure what the robots sense now, but for contact."""
        rows, world = self.rows, self._reset_world()
        visible = with_bodies(world.circles, self.crowd.rows, self.crowd.setup)
        sense(rows.numbers, rows.draws, rows.ranges, world.segments, visible)

    def _readings(self) -> list[Reading]:
        return [self.rows.reading(k) for k in range(len(self.rows.numbers))]

    def _reset_world(self) -> World:
        """Return the world of the last reset."""
        if self._world is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        return self._world

    def _check_number(self, **arguments: Sequence[Any]) -> None:
        count = len(self.rows.numbers)
        for name, values in arguments.items():
            if len(values) != count:
                raise ValueError(f"{name} must have one entry per robot, {count} in all, got {len(values)}")
