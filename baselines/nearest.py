"""Nearest frontier first, goal-committed: the planner that tuned ones beat by a few percent (Yamauchi 1997)."""

import math
from dataclasses import dataclass

import numpy as np

from baselines.goal_explorer import Goal, GoalExplorer
from baselines.navigator import Survey
from baselines.viewpoints import find_viewpoint
from envs.navigation import frontier_clusters
from envs.robots import RobotParams


@dataclass(frozen=True, slots=True)
class NearestParams:
    """What counts as a frontier worth going to."""

    sizes: tuple[int, ...] = (8, 3)
    """Least number of touching frontier cells; the next one is taken when nothing of the size before can be reached."""
    view_distances: tuple[float, ...] = (0.0, 0.3, 0.6, 1.0)
    """How far from a frontier the robot may stand to see it; the first one from which it can is taken [m]."""
    retry_radius: float = 0.5
    """Frontiers this near to one that the robot failed to get to... [m]."""
    max_failures: int = 2
    """...this often are left out, until nothing else is left, and for good after one failure more."""


class NearestExplorer(GoalExplorer):
    """Goes to the frontier that is cheapest to get to: the length of the way, weighted by nearness to obstacles."""

    def __init__(self, params: NearestParams = NearestParams()) -> None:
        """Make an explorer with the given parameters."""
        super().__init__()
        self._params = params

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `Explorer`."""
        super().reset(robot, control_period, rng)
        self._failures: list[tuple[float, float]] = []

    def _failed(self, goal: Goal) -> None:
        self._failures.append(goal.frontier)

    def _num_failures(self, point: np.ndarray) -> int:
        near = self._params.retry_radius
        return sum(math.hypot(point[0] - x, point[1] - y) <= near for x, y in self._failures)

    def _choose(self, survey: Survey) -> Goal | None:
        if survey.field is None:
            return None
        clusters = frontier_clusters(survey.frontier)
        for allowed_failures in (self._params.max_failures - 1, self._params.max_failures):
            for size in self._params.sizes:
                large = [cluster for cluster in clusters if len(cluster) >= size]
                goal = self._nearest(survey, large, allowed_failures)
                if goal is not None:
                    return goal
        return None

    def _nearest(self, survey: Survey, clusters: list[np.ndarray], allowed_failures: int) -> Goal | None:
        assert survey.field is not None
        best, best_cost = None, math.inf
        for cluster in clusters:
            for distance in self._params.view_distances:
                found = find_viewpoint(survey.field, cluster, distance)
                if found is None:
                    continue
                cell, seen = found
                frontier = survey.grid.centers(cluster[seen])
                cost = float(survey.field.cost(np.array(cell)))
                if cost < best_cost and self._num_failures(frontier) <= allowed_failures:
                    best, best_cost = Goal(cell, (float(frontier[0]), float(frontier[1]))), cost
                break
        return best
