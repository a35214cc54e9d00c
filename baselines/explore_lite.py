"""The cost of explore_lite (Horner, "Map-merging for multi-robot system", 2016; ROS package m-explore).

Each frontier is a group of touching cells; the cheapest one, by `potential_scale * distance - gain_scale * size`, is
the goal, and it is asked for anew every few seconds, so that the goal may change on the way. As in that package both
terms are multiplied by the map's resolution, which changes their sum's unit and not their order; the distance is the
straight one to the nearest cell. Two things are ours: the robot goes where it can see the cell nearest to the
centroid, which may lie inside an obstacle; and when no frontier of the least size is left, smaller ones count.
"""

from dataclasses import dataclass

import numpy as np

from baselines.candidates import goal_for
from baselines.goal_explorer import DECISION_PERIOD, MAX_FAILURES, Goal, GoalExplorer
from baselines.survey import Survey
from envs.navigation import frontier_clusters
from envs.robots import RobotParams


@dataclass(frozen=True, slots=True)
class ExploreLiteParams:
    """Defaults: the package's launch file."""

    planner_frequency: float = 0.33
    """How often the goal is chosen anew [1/s]."""
    potential_scale: float = 3.0
    """What a metre of distance costs."""
    gain_scale: float = 1.0
    """What a cell of size is worth."""
    min_frontier_size: float = 0.75
    """Least length of a frontier, its number of cells times the resolution [m]..."""
    min_cells: int = 3
    """...and the number of cells that does when no such frontier can be reached."""

    def __post_init__(self) -> None:
        if not self.planner_frequency > 0:
            raise ValueError(f"planner_frequency must be positive, got {self.planner_frequency}")
        if self.min_cells < 1:
            raise ValueError(f"min_cells must be at least 1, got {self.min_cells}")
        for name in ("potential_scale", "gain_scale", "min_frontier_size"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")


class ExploreLiteExplorer(GoalExplorer):
    """Goes to the frontier with the least of distance minus size."""

    def __init__(self, params: ExploreLiteParams = ExploreLiteParams()) -> None:
        """Make an explorer with the given parameters."""
        super().__init__()
        self._params = params

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `Explorer`."""
        super().reset(robot, control_period, rng)
        self._looks = 0

    def _better(self, survey: Survey, goal: Goal) -> Goal | None:
        self._looks += 1
        if self._looks < round(1.0 / (self._params.planner_frequency * DECISION_PERIOD)):
            return None
        other = self._choose(survey)
        # A goal that has moved by as little as the map is noisy is the same.
        is_same = other is None or bool(np.hypot(*np.subtract(other.frontier, goal.frontier)) < 0.5)
        return None if is_same else other

    def _choose(self, survey: Survey) -> Goal | None:
        self._looks = 0
        if survey.field is None:
            return None
        clusters = sorted(frontier_clusters(survey.frontier), key=lambda cells: self._cost(survey, cells))
        long_enough = self._params.min_frontier_size / survey.grid.resolution
        # Places that the robot failed to get to come last.
        for allowed_failures in (0, MAX_FAILURES):
            for size in (long_enough, self._params.min_cells):
                for cells in clusters:
                    if len(cells) < size:
                        continue
                    centroid = cells.mean(axis=0)
                    middle = cells[np.argmin(((cells - centroid) ** 2).sum(axis=1))]
                    goal = goal_for(survey, survey.field, middle[None]) or goal_for(survey, survey.field, cells)
                    if goal is not None and self._num_failures(goal.frontier) <= allowed_failures:
                        return goal
        return None

    def _cost(self, survey: Survey, cells: np.ndarray) -> float:
        """Return what the package sorts its frontiers by, the smallest first."""
        distances = np.hypot(*(survey.grid.centers(cells) - survey.pose[:2]).T)
        cost = self._params.potential_scale * distances.min() - self._params.gain_scale * len(cells)
        return float(cost * survey.grid.resolution)
