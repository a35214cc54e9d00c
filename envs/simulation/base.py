"""What both physics share: checks, noise, sensors, and the robots' states as rows of numbers."""

import math
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from envs.geometry import Pose2D
from envs.robots import RobotParams
from envs.worlds import World

from .contact import Contact, check_starts, find_contacts
from .sensors import TOUCHED, Sensors
from .simulator import Reading, RobotState, Twist
from .state import STATE_SIZE, Y


class BaseSimulator:
    """A `Simulator` without physics: subclasses implement `_place` and `_move`."""

    ignored: tuple[str, ...] = ()
    """Parameters of robots that make no difference; see `Simulator`."""

    def __init__(self, robot: RobotParams, control_period: float, num_robots: int = 1) -> None:
        self.sensors = Sensors(robot, control_period, num_robots)
        self.rows = np.zeros((num_robots, STATE_SIZE))
        """Shape (num_robots, 11), float64: the robots' states; see `state`."""
        self.commands = np.zeros((num_robots, 2))
        """Shape (num_robots, 2), float64: commanded twists [m/s, rad/s]."""
        self.rngs: Sequence[np.random.Generator] = ()
        self.circles = np.empty((0, 3))
        """What `World.circles_at` returns for the present time."""
        self.steps = 0
        self.robot = robot
        """The true robot."""
        self._radius, self._period = robot.radius, float(control_period)
        self._world: World | None = None
        self._states: list[RobotState] | None = None

    def set_robot(self, robot: RobotParams) -> None:
        """Change the robots' parameters from the next reset on; see `Simulator`."""
        self.robot = robot
        self.sensors.set_robot(robot, self._period)

    @property
    def states(self) -> list[RobotState]:
        """Ground truth of each robot; see `Simulator`."""
        if self._states is None:
            self._reset_world()
            rows = self.rows.tolist()
            self._states = [RobotState(Pose2D(x, y, theta), Twist(v, w)) for x, y, theta, *_, v, w, _, _ in rows]
        return self._states

    @property
    def contacts(self) -> list[Contact]:
        """What the robots touched during the last period; see `Simulator`."""
        touched = np.flatnonzero(self.sensors.others[:, TOUCHED] > 0.0).tolist()
        return find_contacts(touched, self.rows[:, : Y + 1], self._radius, self._reset_world(), self.circles)

    def reset(self, world: World, poses: Sequence[Pose2D], rngs: Sequence[np.random.Generator]) -> list[Reading]:
        """Place the robots at rest and return their first readings; see `Simulator`."""
        self._check_number(poses=poses, rngs=rngs)
        check_starts(poses, self._radius, world)
        self._world, self.rngs, self.circles = world, rngs, world.circles_at(0.0)
        self.go_to(0)
        self.rows[:] = 0.0
        self._place(world, poses)
        self.sensors.draw(rngs)
        self.sensors.draw_biases(self.rows)
        self.sensors.others[:, TOUCHED] = 0.0
        self.sensors.sense(self.rows, world.segments, self.circles)
        return self.sensors.readings(0.0)

    def step(self, commands: Sequence[Twist]) -> list[Reading]:
        """Drive for one control period; see `Simulator`."""
        world = self._reset_world()
        self._check_number(commands=commands)
        checked = [(float(v), float(w)) for v, w in commands]
        for v, w in checked:
            if not (math.isfinite(v) and math.isfinite(w)):
                raise ValueError(f"command must be finite, got v = {v} m/s, w = {w} rad/s")
        self.commands[:] = checked
        self.sensors.draw(self.rngs)
        self.go_to(self.steps + 1)
        time, before = self.steps * self._period, self.circles
        if world.movers:
            self.circles = world.circles_at(time)
        self._move(world, before)
        return self.sensors.readings(time)

    def go_to(self, steps: int) -> None:
        """Take note that `rows` and `sensors` have been stepped to so many steps after the reset."""
        self.steps, self._states = steps, None

    def close(self) -> None:
        """Release what the simulator holds."""

    def _place(self, world: World, poses: Sequence[Pose2D]) -> None:
        """Put the robots at rest at their poses, and write these to `rows`, which hold zeros."""
        raise NotImplementedError

    def _move(self, world: World, before: np.ndarray) -> None:
        """Drive all robots by `commands` for one control period, and measure what they sense at its end.

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
            if len(values) != len(self.rows):
                raise ValueError(f"{name} must have one entry per robot, {len(self.rows)} in all, got {len(values)}")
