"""What both physics share: checks, noise, sensors, and the robots as rows of numbers."""

import math
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from envs.geometry import Pose2D
from envs.robots import RobotParams
from envs.worlds import World

from .contact import Contact, check_starts, find_contacts
from .rows import BLOCK, Rows
from .sensors import sense
from .simulator import Reading, RobotState, Twist
from .state import COMMAND_V, COMMAND_W, TOUCHED, Y


class BaseSimulator:
    """A `Simulator` without physics: subclasses implement `_place` and `_move`."""

    ignored: tuple[str, ...] = ()
    """Parameters of robots that make no difference; see `Simulator`."""

    def __init__(self, robot: RobotParams, control_period: float, num_robots: int = 1) -> None:
        self.rows = Rows(robot, control_period, num_robots)
        """The robots' states, measurements and noise."""
        self.rngs: Sequence[np.random.Generator] = ()
        self.circles = np.empty((0, 3))
        """What `World.circles_at` returns for the present time."""
        self.robot = robot
        """The true robot."""
        self._radius, self._period = robot.radius, float(control_period)
        self._world: World | None = None

    def set_robot(self, robot: RobotParams) -> None:
        """Change the robots' parameters from the next reset on; see `Simulator`."""
        self.robot = robot
        self.rows.set_robot(robot, self._period)

    @property
    def states(self) -> list[RobotState]:
        """Ground truth of each robot; see `Simulator`."""
        self._reset_world()
        return [self.rows.state(k) for k in range(len(self.rows.numbers))]

    @property
    def contacts(self) -> list[Contact]:
        """What the robots touched during the last period; see `Simulator`."""
        touched = np.flatnonzero(self.rows.numbers[:, TOUCHED] > 0.0).tolist()
        return find_contacts(touched, self.rows.numbers[:, : Y + 1], self._radius, self._reset_world(), self.circles)

    def reset(self, world: World, poses: Sequence[Pose2D], rngs: Sequence[np.random.Generator]) -> list[Reading]:
        """Place the robots at rest and return their first readings; see `Simulator`."""
        self._check_number(poses=poses, rngs=rngs)
        check_starts(poses, self._radius, world)
        self._world, self.rngs, self.circles, rows = world, rngs, world.circles_at(0.0), self.rows
        rows.reset()
        self._place(world, poses)
        rows.draw(rngs)
        rows.draw_biases()
        sense(rows.numbers, rows.draws, rows.ranges, world.segments, self.circles)
        return self._readings()

    def step(self, commands: Sequence[Twist]) -> list[Reading]:
        """Drive for one control period; see `Simulator`."""
        self.move(commands, 1)
        return self._readings()

    def move(self, commands: Sequence[Twist], ahead: int = BLOCK) -> None:
        """Drive for one control period, after which `rows` hold what `step` returns; raises as `step`.

        Args:
            commands: as for `step`.
            ahead: control periods for which noise is drawn at once, which nobody else may draw from the generators.
        """
        world, rows = self._reset_world(), self.rows
        self._check_number(commands=commands)
        for k, (v, w) in enumerate(commands):
            if not (math.isfinite(v) and math.isfinite(w)):
                raise ValueError(f"command must be finite, got v = {v} m/s, w = {w} rad/s")
            rows.numbers[k, COMMAND_V], rows.numbers[k, COMMAND_W] = v, w
        rows.draw_ahead(self.rngs, ahead)
        self._move(world, self.move_circles())

    def move_circles(self) -> np.ndarray:
        """Take `circles` to the end of the coming control period; return them as they are at its beginning."""
        before, world = self.circles, self._reset_world()
        if world.movers:
            self.circles = world.circles_at((self.rows.steps + 1) * self._period)
        return before

    def close(self) -> None:
        """Release what the simulator holds."""

    def _readings(self) -> list[Reading]:
        return [self.rows.reading(k) for k in range(len(self.rows.numbers))]

    def _place(self, world: World, poses: Sequence[Pose2D]) -> None:
        """Put the robots at rest at their poses, and write these to `rows`."""
        raise NotImplementedError

    def _move(self, world: World, before: np.ndarray) -> None:
        """Drive all robots by the commands in `rows` for one control period, and measure what they sense at its end.

        Meanwhile circles go evenly from `before`, shape (m, 3), float64 [m], to `circles`.
        """
        raise NotImplementedError

    def _reset_world(self) -> World:
        """Return the world of the last reset."""
        if self._world is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        return self._world

    def _check_number(self, **arguments: Sequence[Any]) -> None:
        for name, values in arguments.items():
            if len(values) != len(self.rows.numbers):
                raise ValueError(
                    f"{name} must have one entry per robot, {len(self.rows.numbers)} in all, got {len(values)}"
                )
