"""The explorer of all teams: asks a rule which robot goes to which frontier, and drives there."""

import math
from collections.abc import Sequence

import numpy as np

from lidarnaut.baselines.frontier.pursuit import pursue
from lidarnaut.baselines.teams.assignment import Assignment
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.navigation.team_navigator import TeamNavigator
from lidarnaut.envs.navigation.team_robot import TeamRobot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

PERIOD = 1.0
"""Time after which frontiers are assigned anew to all robots [s]; sooner when one of them needs another."""


class TeamExplorer:
    """Explores with one or several robots that drive where a rule says, by pursuit driving."""

    is_team = True
    plan = None
    """Each robot has its own, see `plans`."""

    def __init__(self, rule: Assignment | None = None, *, period: float = PERIOD) -> None:
        """Take a rule, which is asked about all robots every `period` seconds, and when one needs a frontier.

        With a `period` of inf only robots that need a frontier are assigned one.
        """
        self.rule, self.period = rule, period
        self._navigator: TeamNavigator | None = None
        self._is_reset = False

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `lidarnaut.baselines.explorer.Policy`."""
        self._robot, self._control_period, self._is_reset = robot, control_period, True
        self._navigator, self._steps = None, 0

    @property
    def end_reason(self) -> str | None:
        """Why the team has stopped exploring; None while any of its robots has not."""
        return None if self._navigator is None else self._navigator.end_reason

    @property
    def plans(self) -> list[np.ndarray | None]:
        """The planned path of each robot for drawing, shape (n, 2), map frame [m]; None without one."""
        return [] if self._navigator is None else self._navigator.plans

    @property
    def targets(self) -> list[tuple[float, float] | None]:
        """The frontier that each robot drives to (x, y), map frame [m]; None for a robot without one."""
        return [] if self._navigator is None else self._navigator.targets

    def act(self, readings: Sequence[Reading], beliefs: Sequence[Belief]) -> list[Twist]:
        """Return the twist of each robot, from its reading and its belief; the map in these is one and the same.

        Raises a RuntimeError before the first `reset`.
        """
        if not self._is_reset:
            raise RuntimeError("call reset before act")
        if self._navigator is None:
            self._navigator = TeamNavigator(self._robot, [self._make_robot(k) for k in range(len(readings))])
        navigator = self._navigator
        if navigator.end_reason is not None:
            return [Twist(0.0, 0.0) for _ in readings]
        self._look(navigator.team, beliefs)
        self._steps += 1
        is_time = self._steps * self._control_period >= self.period
        due = navigator.update(readings, beliefs, is_asked=is_time)
        if (due or is_time) and math.isfinite(self.period):
            self._steps = 0
            for robot in navigator.team:
                if robot not in due and robot.may_turn_away:
                    robot.refresh(readings[robot.index], beliefs[robot.index])
                    due.append(robot)
        if due:
            navigator.choose(due, self._assign(due, beliefs))
        return [self._command(robot, belief) for robot, belief in zip(navigator.team, beliefs, strict=True)]

    def _make_robot(self, index: int) -> TeamRobot:
        return TeamRobot(self._robot, self._control_period, index)

    def _look(self, team: Sequence[TeamRobot], beliefs: Sequence[Belief]) -> None:
        """Look at the map before robots are due."""

    def _assign(self, due: Sequence[TeamRobot], beliefs: Sequence[Belief]) -> Sequence[int]:
        """Return the index of the candidate of each robot that is due, or `UNASSIGNED`."""
        assert self.rule is not None
        assert self._navigator is not None
        taken = [robot.driving_to for robot in self._navigator.team if robot not in due]
        points = np.array([target for target in taken if target is not None]).reshape(-1, 2)
        return self.rule([robot.candidates for robot in due], points, [beliefs[robot.index] for robot in due])

    def _command(self, robot: TeamRobot, belief: Belief) -> Twist:
        twist, drive = robot.command(belief), robot.navigator
        if robot.yielding_to is not None:
            return twist
        return pursue(robot, self._robot, belief.pose, twist, drive.arrays.obstacles[: drive.record["num_obstacles"]])
