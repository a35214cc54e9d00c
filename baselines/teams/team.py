import math
from collections.abc import Sequence

import numpy as np

from lidarnaut.baselines.frontier.pursuit_explorer import pursue
from lidarnaut.baselines.teams.assignment import Assignment
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.navigation import Markers
from lidarnaut.envs.navigation.policy import Explorer
from lidarnaut.envs.navigation.teams.team_navigator import TeamNavigator
from lidarnaut.envs.navigation.teams.team_robot import TeamRobot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

PERIOD = 1.0
"""Time between assignments of frontiers to all robots [s]."""


class TeamExplorer(Explorer):
    """Assigns frontiers to one or several robots, and steers each robot along its path."""

    is_team = True

    def __init__(self, rule: Assignment | None = None, *, period: float = PERIOD) -> None:
        """Create a team with a rule that assigns frontiers to robots.

        Frontiers of all robots are reassigned every `period` [s], and when a robot needs a new frontier. With an
        infinite `period`, only robots that need a frontier get one.
        """
        self.rule, self.period = rule, period
        self._navigator: TeamNavigator | None = None

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._robot, self._control_period = robot, control_period
        self._navigator, self._steps = None, 0

    @property
    def end_reason(self) -> str | None:  # type: ignore[override]
        return None if self._navigator is None else self._navigator.end_reason

    @property
    def plans(self) -> list[np.ndarray | None]:
        return [] if self._navigator is None else self._navigator.plans

    @property
    def markers(self) -> Markers | None:  # type: ignore[override]
        return None if self._navigator is None else Markers.of(self._navigator.team)

    def act(self, readings: Sequence[Reading], beliefs: Sequence[Belief]) -> list[Twist]:  # type: ignore[override]
        if not hasattr(self, "_robot"):
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
                if robot not in due and robot.driving_to is not None and not robot.navigator.is_recovering:
                    robot.refresh(readings[robot.index], beliefs[robot.index])
                    due.append(robot)
        if due:
            navigator.choose(due, self._assign(due, beliefs))
        return [self._command(robot, belief) for robot, belief in zip(navigator.team, beliefs, strict=True)]

    def _make_robot(self, index: int) -> TeamRobot:
        return TeamRobot(self._robot, self._control_period, index)

    def _look(self, team: Sequence[TeamRobot], beliefs: Sequence[Belief]) -> None:
        """Hook, called before each action, to update data that all robots share, such as random trees."""

    def _assign(self, due: Sequence[TeamRobot], beliefs: Sequence[Belief]) -> Sequence[int]:
        assert self.rule is not None
        assert self._navigator is not None
        taken = [robot.driving_to for robot in self._navigator.team if robot not in due]
        points = np.array([target for target in taken if target is not None]).reshape(-1, 2)
        return self.rule([robot.candidates for robot in due], points, [beliefs[robot.index] for robot in due])

    def _command(self, robot: TeamRobot, belief: Belief) -> Twist:
        twist, drive = robot.command(belief), robot.navigator
        if robot.yielding_to is not None:
            return twist
        return pursue(robot, belief.pose, twist, drive.arrays.obstacles[: drive.record["num_obstacles"]])
