"""One robot of a team: drives to the point that it is assigned, yields, and waits."""

from collections.abc import Callable

import numpy as np

from baselines.goal_explorer import GoalExplorer
from baselines.navigator import NO_POINTS, Navigator, Status
from baselines.recovery import Dwell
from baselines.rrt.detector import RrtDetector
from baselines.rrt.explorer import RrtExplorer
from baselines.rrt.goals import OpenGoals
from baselines.rrt.params import RrtParams
from baselines.rrt.right_of_way import find_waiting_cell, is_beside
from baselines.survey import Survey
from envs.robots import RobotParams
from envs.slam import Belief

BLOCKED_TIME = 1.0
"""Time without progress after which a robot is blocked [s]."""
PASSED_CLEARANCE = 0.5
"""Gap between the footprint of a waiting robot and the path of the other one from which that one has passed [m]."""
MAX_WAIT = 15.0
"""Longest time to wait [s]."""

Assign = Callable[["TeamRobot", Survey, OpenGoals], int]
"""Returns the index of the open goal that a robot gets, or `NOBODY`; see `RrtExplorer`."""


class TeamRobot(RrtExplorer):
    """One robot of the team. It decides for itself how to get to the point that the team assigns to it."""

    def __init__(self, params: RrtParams, index: int, assign: Assign, is_exploring: Callable[[], bool]) -> None:
        """Make a robot of a team.

        Args:
            params: of the team.
            index: of the robot.
            assign: assigns one of its open goals to it, see `RrtTeam`.
            is_exploring: tells whether any robot of the team has a point.
        """
        super().__init__(params)
        self.index = index
        self._assign = assign
        self._is_exploring = is_exploring

    def join(self, robot: RobotParams, control_period: float, rng: np.random.Generator, detector: RrtDetector) -> None:
        """Prepare for a new episode with the team's detector."""
        self.reset(robot, control_period, rng)
        self._detector = detector
        self._progress = Dwell(0.25 * robot.radius + 0.02, 0.3)
        self._blocked_time = 0.0
        self._pause = 0
        self._wait_time = 0.0
        self.yielding_to: TeamRobot | None = None
        self.standing, self.passing = NO_POINTS, NO_POINTS
        """Outlines of the peers that plans lead around, and of those that they lead through; base frame [m]."""
        self._surveys: dict[int, Survey] = {}

    @property
    def navigator(self) -> Navigator:
        """Its navigator."""
        assert self._navigator is not None
        return self._navigator

    @property
    def target(self) -> tuple[float, float] | None:
        """The frontier that it drives to (x, y), map frame [m]; None without one."""
        return None if self._goal is None else self._goal.frontier

    @property
    def precedence(self) -> tuple[bool, int]:
        """The robot with the lower one has the right of way."""
        return self._goal is None, self.index

    @property
    def is_blocked(self) -> bool:
        """Whether it drives to a goal and makes no progress."""
        return self._blocked_time > BLOCKED_TIME and not self.navigator.is_busy and self.navigator.plan is not None

    def sense(self, observation: dict[str, np.ndarray]) -> None:
        """Update the obstacles by an observation; to be called with each, before any robot of the team acts."""
        self.navigator.sense(observation, self.standing, self.passing)
        self._surveys.clear()

    def drive(self, observation: dict[str, np.ndarray], belief: Belief) -> np.ndarray:
        """Return the action; see `Explorer`. The observation has been sensed already."""
        self._blocked_time = self._progress.update(belief.pose) * self._period
        self._idle_steps += 1
        self._pause -= 1
        return GoalExplorer._act(self, observation, belief)

    def open_goals(self, belief: Belief) -> tuple[Survey, OpenGoals]:
        """Return its view of the map, and what can be assigned to it."""
        survey = self._survey(self.navigator, belief, self.navigator.tightness)
        return survey, self._open_goals(survey)

    def yield_to(self, belief: Belief, other: "TeamRobot") -> bool:
        """Drop the own goal and drive off the path of another robot; False if there is nowhere to go."""
        path = other.navigator.plan
        survey = self.navigator.survey(belief)
        cell = None if path is None else find_waiting_cell(survey, path, self._robot.radius)
        if cell is None:
            return False
        assert survey.field is not None
        route = survey.field.path(*cell)
        assert route is not None
        x, y = survey.grid.centers(np.array(cell))
        self.navigator.drive_to((float(x), float(y)), route)
        self._goal, self.yielding_to, self._wait_time = None, other, 0.0
        return True

    def reset_progress(self) -> None:
        """Measure progress anew from here."""
        self._progress.restart()
        self._blocked_time = 0.0

    def resume(self) -> None:
        """Go on, since a teammate still explores."""
        self._end_reason = None
        self._idle_steps = 0

    def _sense(self, navigator: Navigator, observation: dict[str, np.ndarray]) -> None:
        """See `sense`."""

    def _survey(self, navigator: Navigator, belief: Belief, tightness: int) -> Survey:
        # Once in a step: each peer without a point may ask.
        if tightness not in self._surveys:
            self._surveys[tightness] = super()._survey(navigator, belief, tightness)
        return self._surveys[tightness]

    def _consider(self, navigator: Navigator, belief: Belief) -> None:
        if self.yielding_to is not None:
            if not self._has_passed(self.yielding_to, belief):
                return
            self.yielding_to = None
            navigator.wait()
        if self._pause > 0 and self._goal is None:
            return
        super()._consider(navigator, belief)
        if self._goal is None and self._is_exploring():
            # Nothing is left for this robot as things stand: no reason to turn around, or to plan in every step.
            navigator.wait()
            self._end_reason, self._has_looked_around, self._pause = None, False, self._decision_steps

    def _has_passed(self, other: "TeamRobot", belief: Belief) -> bool:
        path = other.navigator.plan
        if path is None:
            return True
        if self.navigator.status is Status.DRIVING:
            return False
        self._wait_time += self._period
        is_off = not is_beside(belief.pose[:2], path, 2.0 * self._robot.radius + PASSED_CLEARANCE)
        return is_off or self._wait_time > MAX_WAIT

    def _assigned(self, survey: Survey, goals: OpenGoals) -> int:
        return self._assign(self, survey, goals)
