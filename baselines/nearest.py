"""Nearest frontier first, goal-committed: the planner that tuned ones beat by a few percent (Yamauchi 1997)."""

import math
from dataclasses import dataclass

import numpy as np

from baselines.goal_explorer import MAX_FAILURES, Goal, GoalExplorer
from baselines.survey import Survey
from baselines.viewpoints import find_viewpoint
from envs.navigation import frontier_clusters


@dataclass(frozen=True, slots=True)
class NearestParams:
    """What counts as a frontier worth going to."""

    sizes: tuple[int, ...] = (8, 3)
    """Least number of touching frontier cells; the next one is taken when nothing of the size before can be reached."""
    view_distances: tuple[float, ...] = (0.0, 0.3, 0.6, 1.0)
    """How far from a frontier the robot may stand to see it; the first one from which it can is taken [m]."""


class NearestExplorer(GoalExplorer):
    """Goes to the frontier that is cheapest to get to: the length of the way, weighted by nearness to obstacles."""

    def __init__(self, params: NearestParams = NearestParams()) -> None:
        """Make an explorer with the given parameters."""
        super().__init__()
        self._params = params

    def _choose(self, survey: Survey) -> Goal | None:
        if survey.field is None:
            return None
        clusters = frontier_clusters(survey.frontier)
        # Places that the robot failed to get to come last.
        for allowed_failures in (0, MAX_FAILURES):
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
                x, y = survey.grid.centers(cluster[seen])
                frontier = float(x), float(y)
                cost = float(survey.field.cost(np.array(cell)))
                if cost < best_cost and self._num_failures(frontier) <= allowed_failures:
                    best, best_cost = Goal(cell, frontier), cost
                break
        return best
