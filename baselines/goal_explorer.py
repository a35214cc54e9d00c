"""What the frontier explorers share: commit to a goal, drive there, look, choose the next."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from baselines.navigator import Navigator, Status
from baselines.recovery import Dwell
from baselines.rrt.trees import BLOCKED, grid_check
from baselines.senses import Senses
from baselines.survey import Survey
from envs.navigation import clear_around, frontier_clusters
from envs.robots import RobotParams
from envs.simulation import Reading, Twist
from envs.slam import Belief

DECISION_PERIOD = 1.0
"""Time between two looks at the map [s]."""
LOOK_RADIUS = 3.0
"""Frontier cells are given up with the goal that was to show them, when the robot has stood there in vain, if they lie
in its sight and no farther away than the goal's and this more, in radii of the robot and at most 0.75 m; and as near as
this to a goal that failed too often."""
MIN_CELLS = 3
"""Fewer frontier cells that touch are none."""
IMPATIENCE = 1.3
"""Factor by which these two grow with each goal that was in vain: a map that has drifted is full of small frontiers
that nothing lies behind. A goal that showed enough ends it."""
MAX_IMPATIENCE = 8.0
"""The most that they grow to."""
WORTHWHILE = 4.0
"""Side of the square of newly known area that is enough, in radii of the robot."""
GOAL_RADIUS = 0.4
"""A goal is worth its way as long as there is a frontier this near to the one that it was chosen for [m]."""
RETRY_RADIUS = 0.5
"""Goals that failed count as the same goal within this distance [m]."""
MAX_FAILURES = 3
"""Failures after which a goal's frontier is given up."""
STILL_DISTANCE = 0.1
"""An explorer that runs out of goals when it has not come farther than this... [m]"""
STILL_TIME = 60.0
"""...for this long is stuck [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """Where to go, and what to see from there."""

    cell: tuple[int, int]
    """Where to stand: (row, column) in the survey's grid, reachable."""
    frontier: tuple[float, float]
    """The frontier to look at (x, y), map frame [m]."""


class GoalExplorer(ABC):
    """An explorer that drives from frontier to frontier; subclasses choose which."""

    def __init__(self) -> None:
        """Make an explorer; `reset` prepares it for an episode."""
        self._end_reason: str | None = None
        self._navigator: Navigator | None = None

    @property
    def end_reason(self) -> str | None:
        """Why no goal is left: `"no_reachable_frontier"`, or `"stuck"` if the robot could not move; None before."""
        return self._end_reason

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return None if self._navigator is None else self._navigator.plan

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `Explorer`."""
        self._robot = robot
        self._navigator = Navigator(robot, control_period, rng)
        self._senses = Senses(robot, control_period)
        self._look_radius = min(LOOK_RADIUS * robot.radius, 0.75)
        self._has_looked_around = False
        self._decision_steps = max(1, round(DECISION_PERIOD / control_period))
        self._countdown = 0
        self._goal: Goal | None = None
        self._end_reason = None
        self._dwell = Dwell(STILL_DISTANCE)
        self._still_time = 0.0
        self._period = control_period
        self._given_up = np.empty((0, 2))
        self._num_vain = 0
        self._known = 0.0
        # How small the robot is in the plans of the next look for a goal.
        self._tightness = 0
        self._failures: list[tuple[float, float]] = []
        # Goals that the robot has turned away from since the last one that came to an end.
        self._left: list[tuple[float, float]] = []

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist; see `Explorer`."""
        if self._navigator is None:
            raise RuntimeError("call reset before act")
        return self._senses.twist(self._act(self._senses.observe(reading), belief))

    def _act(self, observation: dict[str, np.ndarray], belief: Belief) -> np.ndarray:
        """Return the action for `scan` and `motion` of an observation."""
        navigator = self._navigator
        if navigator is None:
            raise RuntimeError("call reset before act")
        if self._end_reason is not None:
            return np.zeros(2, dtype=np.float32)
        self._sense(navigator, observation)
        self._still_time = self._dwell.update(belief.pose) * self._period
        self._countdown -= 1
        is_due = navigator.status is not Status.DRIVING or self._countdown <= 0 or self._tightness > 0
        if is_due and not navigator.is_busy:
            self._countdown = self._decision_steps
            self._consider(navigator, belief)
        return navigator.act(observation, belief)

    def _sense(self, navigator: Navigator, observation: dict[str, np.ndarray]) -> None:
        """Let the navigator take in the obstacles around the robot."""
        navigator.sense(observation)

    def _consider(self, navigator: Navigator, belief: Belief) -> None:
        """Keep the goal if it is worth it, otherwise choose another one."""
        survey = self._survey(navigator, belief, navigator.tightness)
        if self._goal is not None:
            remaining = self._frontier_near(survey, self._goal.frontier, GOAL_RADIUS)
            if navigator.status is Status.REACHED:
                if len(remaining):
                    self._give_up_in_sight(survey, self._goal, remaining)
            elif navigator.status is Status.FAILED:
                self._fail(survey, self._goal)
            elif len(remaining) and navigator.replan(survey):
                better = self._better(survey, self._goal)
                if better is not None and not _is_near(better.frontier, self._left):
                    self._left.append(self._goal.frontier)
                    self._goal = better
                    self._set_out(navigator, survey, better, navigator.tightness, is_change=True)
                return
            elif len(remaining):
                self._fail(survey, self._goal)
            self._weigh_gain(survey)
        self._left.clear()
        # One look per step: four in one would take longer than a control period in a large place.
        is_same = self._tightness == navigator.tightness
        again = survey if is_same else self._survey(navigator, belief, self._tightness)
        self._goal = self._choose(again)
        if self._goal is not None:
            self._set_out(navigator, again, self._goal, self._tightness)
            self._tightness = 0
            return
        if self._tightness < navigator.max_tightness:
            self._tightness += 1
            return
        self._tightness = 0
        if self._has_looked_around:
            is_stuck = again.field is None or self._still_time > STILL_TIME
            self._end_reason = "stuck" if is_stuck else "no_reachable_frontier"
        self._has_looked_around = True
        navigator.look_around()

    def _survey(self, navigator: Navigator, belief: Belief, tightness: int) -> Survey:
        """Look at the map, without the frontiers that have been given up or are not worth the way."""
        survey = navigator.survey(belief, tightness)
        useful = clear_around(survey.frontier, survey.grid.cells(self._given_up))
        self._given_up = self._given_up[useful]
        if self._num_vain:
            clusters = frontier_clusters(survey.frontier)
            small = [cells for cells in clusters if len(cells) < MIN_CELLS * self._impatience]
            rows, cols = np.concatenate([np.empty((0, 2), dtype=np.int64), *small]).T
            survey.frontier[rows, cols] = False
        return survey

    def _set_out(
        self, navigator: Navigator, survey: Survey, goal: Goal, tightness: int, *, is_change: bool = False
    ) -> None:
        assert survey.field is not None
        path = survey.field.path(*goal.cell)
        assert path is not None
        x, y = survey.grid.centers(np.array(goal.cell))
        navigator.drive_to((float(x), float(y)), path, view=goal.frontier, tightness=tightness, is_change=is_change)
        self._has_looked_around = False

    @property
    def _impatience(self) -> float:
        """How much more must speak for a frontier than at first."""
        return float(min(IMPATIENCE**self._num_vain, MAX_IMPATIENCE))

    @abstractmethod
    def _choose(self, survey: Survey) -> Goal | None:
        """Return the next goal; None if nothing that is left can be reached."""

    def _better(self, survey: Survey, goal: Goal) -> Goal | None:
        """Return what to go for instead of a goal that is still worth its way; None to stay with it, as by default."""
        return None

    def _fail(self, survey: Survey, goal: Goal) -> None:
        """Take note that the robot did not get to a goal."""
        self._failures.append(goal.frontier)
        self._num_vain += 1
        if self._num_failures(goal.frontier) >= MAX_FAILURES:
            self._give_up(survey, self._frontier_near(survey, goal.frontier, self._look_radius))

    def _give_up_in_sight(self, survey: Survey, goal: Goal, remaining: np.ndarray) -> None:
        """Give up what has not come to light though the robot stands where it wanted to see it from.

        Args:
            survey: the map.
            goal: where the robot stands.
            remaining: shape (k, 2), int64, the frontier cells that it was for.
        """
        gap = math.hypot(goal.frontier[0] - survey.pose.x, goal.frontier[1] - survey.pose.y)
        around = self._frontier_near(survey, survey.pose[:2], gap + self._look_radius * self._impatience)
        u, v = (np.array(survey.pose[:2]) - survey.grid.origin) / survey.grid.resolution
        in_sight = [grid_check(survey.grid.data, u, v, col + 0.5, row + 0.5)[0] != BLOCKED for row, col in around]
        self._give_up(survey, np.concatenate([remaining, around[np.array(in_sight, dtype=np.bool_)]]))
        self._num_vain += 1

    def _weigh_gain(self, survey: Survey) -> None:
        """Forget goals that were in vain if the last one has shown enough."""
        known = np.count_nonzero(survey.grid.data >= 0) * survey.grid.resolution**2
        if known >= self._known + (WORTHWHILE * self._robot.radius) ** 2:
            self._num_vain = 0
        self._known = known

    def _num_failures(self, point: tuple[float, float]) -> int:
        """Return how often the robot did not get to a frontier (x, y), map frame [m]."""
        return int(self._count_failures(np.array([point]))[0])

    def _count_failures(self, points: np.ndarray) -> np.ndarray:
        """Return how often the robot did not get to frontiers (shape (n, 2), map frame [m]): shape (n,), int64."""
        gaps = points[:, None] - np.array(self._failures).reshape(-1, 2)
        return np.count_nonzero(np.hypot(gaps[..., 0], gaps[..., 1]) <= RETRY_RADIUS, axis=1)

    def _frontier_near(self, survey: Survey, point: tuple[float, float], radius: float) -> np.ndarray:
        """Return the frontier cells within `radius` [m] of a point: shape (k, 2), (row, column)."""
        row, col = (int(k) for k in survey.grid.cells(np.array(point)))
        reach = math.ceil(radius / survey.grid.resolution)
        top, left = max(row - reach, 0), max(col - reach, 0)
        window = survey.frontier[top : max(row + reach + 1, 0), left : max(col + reach + 1, 0)]
        cells = np.argwhere(window) + (top, left)
        distances = np.hypot(*(survey.grid.centers(cells) - point).T)
        return cells[distances <= radius]

    def _give_up(self, survey: Survey, cells: np.ndarray) -> None:
        """Leave frontier cells, shape (k, 2), (row, column), out from now on."""
        self._given_up = np.concatenate([self._given_up, survey.grid.centers(cells)])
        survey.frontier[cells[:, 0], cells[:, 1]] = False


def _is_near(point: tuple[float, float], others: list[tuple[float, float]]) -> bool:
    """Tell whether a frontier (x, y) [m] is the same as any of others."""
    return any(math.hypot(point[0] - x, point[1] - y) <= RETRY_RADIUS for x, y in others)
