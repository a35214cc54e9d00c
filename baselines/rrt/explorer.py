"""Seed 2's explorer: random trees find frontiers, a filter thins them out, an assigner picks one by revenue.

After Umari and Mukhopadhyay, "Autonomous Robotic Exploration Based on Multiple Rapidly-exploring Randomized Trees"
(2017). Where the seed leaves something open, its launch file and the program behind it decide, with these exceptions:

- *The region.* That program has a person click the corners of the region to sample. Ours is the rectangle around
  everything observed and a margin.
- *Navigation cost.* The seed asks for the way that the robot is expected to drive; the program takes the distance
  as the crow flies. We have the way, weighted by nearness to obstacles.
- *Invalid points.* The seed drops points that no way leads to, the program those in costly cells; we do both. A point's
  goal is the frontier cell nearest to it, because the mean of points along a bend lies beside the frontier. What the
  robot could not see from where it stood to look at it is no frontier any more.
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
from baselines.rrt.goals import goals_of
from baselines.rrt.params import RrtParams
from baselines.rrt.trees import Tree
from baselines.survey import Survey
from envs.robots import RobotParams
from envs.slam import Belief


class RrtExplorer(GoalExplorer):
    """Goes to the frontier point of the greatest revenue among those that two random trees have run into."""

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
        places, frontiers = self._open_goals(survey)
        best = self._assigned(survey, places, frontiers) if len(places) else NOBODY
        if best == NOBODY:
            return None
        (row, col), (x, y) = places[best], frontiers[best]
        return Goal((int(row), int(col)), (float(x), float(y)))

    def _open_goals(self, survey: Survey) -> tuple[np.ndarray, np.ndarray]:
        """Return where the robot may go; places that it failed to get to only if there is nothing else.

        Returns:
            Shape (n, 2), int64, places (row, column), and shape (n, 2), float64, the frontiers to see from there
            (x, y), map frame [m].
        """
        if survey.field is None:
            return np.empty((0, 2), dtype=np.int64), np.empty((0, 2))
        params = self._params
        places, cells = goals_of(
            survey,
            self.points,
            max_cost=params.max_cost,
            radius=params.bandwidth,
            view_distances=params.view_distances,
        )
        frontiers = survey.grid.centers(cells)
        failures = self._count_failures(frontiers)
        is_open = failures == 0
        if not is_open.any():
            is_open = failures < MAX_FAILURES
        return places[is_open], frontiers[is_open]

    def _assigned(self, survey: Survey, places: np.ndarray, frontiers: np.ndarray) -> int:
        """Return the index of the frontier of the greatest revenue; `NOBODY` for none; see `_open_goals`."""
        assert survey.field is not None
        costs = survey.field.cost(places)[None]
        return int(assign(survey.grid, np.array([survey.pose[:2]]), frontiers, costs, self._params)[0])
