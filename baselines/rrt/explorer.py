"""The explorer of Nguyen et al. (2022): random trees find frontiers, a filter clusters them, revenue picks one.

Nguyen, Tran and Nguyen, "SLAM cho robot di động" (2022), after Umari and Mukhopadhyay, "Autonomous Robotic Exploration
Based on Multiple Rapidly-exploring Randomized Trees" (2017). Where the report leaves something open, its launch file
and the program behind it decide, with these exceptions:

- *The region.* That program has a person click the corners of the region to sample. Ours is the rectangle around
  everything observed and a margin.
- *Navigation cost.* The report asks for the path that the robot is expected to drive; the program takes the straight
  distance. We take the path, weighted by nearness to obstacles.
- *Invalid points.* The report drops points that no path leads to, the program those in costly cells; we do both. A
  point's goal is the frontier cell nearest to it, because the mean of points along a bend lies beside the frontier.
  What the robot could not see from the viewpoint that it took for it is no frontier any more.
- *The end.* The program never ends. Here exploration is over when the robot has turned once around, and the trees have
  grown for `patience` steps, without any point that could be assigned. Trees are random, so more may be left than by an
  explorer that lists all frontier cells.

The robot keeps its point until it is there, or the frontier around it is gone.
"""

import numpy as np

from baselines.goal_explorer import MAX_FAILURES, Goal, GoalExplorer
from baselines.navigator import Navigator
from baselines.rrt.assigner import NOBODY, assign
from baselines.rrt.detector import RrtDetector
from baselines.rrt.goals import OpenGoals, goals_of
from baselines.rrt.params import RrtParams
from baselines.rrt.trees import Tree
from baselines.survey import Survey
from envs.robots import RobotParams
from envs.slam import Belief


class RrtExplorer(GoalExplorer):
    """Drives to the frontier point of the highest revenue among those that two random trees have found."""

    def __init__(self, params: RrtParams = RrtParams()) -> None:
        """Make an explorer with the given parameters."""
        super().__init__()
        self._params = params
        self._detector: RrtDetector | None = None

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `Explorer`."""
        super().reset(robot, control_period, rng)
        self._detector = RrtDetector(self._params, rng)
        self._idle_steps = 0

    @property
    def points(self) -> np.ndarray:
        """Frontier points that have passed the filter, shape (n, 2), float64, map frame [m]."""
        return np.empty((0, 2)) if self._detector is None else self._detector.points

    @property
    def trees(self) -> list[Tree]:
        """The local and the global tree; none before the first step."""
        return [] if self._detector is None else self._detector.trees

    def _act(self, observation: dict[str, np.ndarray], belief: Belief) -> np.ndarray:
        if self._detector is not None and self._end_reason is None:
            self._detector.detect(belief.grid, [belief.pose[:2]])
            self._idle_steps += 1
        return super()._act(observation, belief)

    def _consider(self, navigator: Navigator, belief: Belief) -> None:
        super()._consider(navigator, belief)
        if self._goal is not None:
            self._idle_steps = 0
        elif self._idle_steps < self._params.patience:
            self._end_reason = None

    def _choose(self, survey: Survey) -> Goal | None:
        goals = self._open_goals(survey)
        best = self._assigned(survey, goals) if len(goals.viewpoints) else NOBODY
        if best == NOBODY:
            return None
        (row, col), (x, y) = goals.viewpoints[best], goals.frontiers[best]
        return Goal((int(row), int(col)), (float(x), float(y)))

    def _open_goals(self, survey: Survey) -> OpenGoals:
        """Return what can be assigned to the robot; goals that it failed to reach only if there are no others."""
        if survey.field is None:
            return OpenGoals(np.empty((0, 2), dtype=np.int64), np.empty((0, 2)))
        goals = goals_of(survey, self.points, self._params)
        failures = self._count_failures(goals.frontiers)
        is_open = failures == 0
        if not is_open.any():
            is_open = failures < MAX_FAILURES
        return OpenGoals(goals.viewpoints[is_open], goals.frontiers[is_open])

    def _assigned(self, survey: Survey, goals: OpenGoals) -> int:
        """Return the index of the goal of the highest revenue; `NOBODY` for none."""
        assert survey.field is not None
        costs = survey.field.cost(goals.viewpoints)[None]
        return int(assign(survey.grid, np.array([survey.pose[:2]]), goals.frontiers, costs, self._params)[0])
