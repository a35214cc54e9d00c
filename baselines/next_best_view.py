"""A next-best-view planner: sampled viewpoints, ray-cast gain, discounted by the length of the way.

The utility of a view is that of Bircher, Kamel, Alexis, Oleynikova, Siegwart, "Receding Horizon 'Next-Best-View'
Planner for 3D Exploration" (2016): `gain * exp(-discount * length)`. Views are sampled where they can gain anything,
around frontier cells drawn at random, instead of with a tree.
"""

from dataclasses import dataclass

import numpy as np

from baselines.candidates import goal_for
from baselines.goal_explorer import MAX_FAILURES, Goal, GoalExplorer
from baselines.survey import Survey
from baselines.visible_gain import visible_gains
from envs.navigation import TravelField, frontier_clusters
from envs.robots import RobotParams


@dataclass(frozen=True, slots=True)
class NextBestViewParams:
    """How to sample views and to value them."""

    num_samples: int = 40
    """Frontier cells around which a viewpoint is looked for."""
    discount: float = 0.5
    """Rate at which a gain loses its value along the way [1/m] (the paper's lambda)."""
    max_range: float = 8.0
    """How far a view is taken to reach at most, where the lidar sees farther [m]."""
    sizes: tuple[int, ...] = (8, 3)
    """Least number of touching frontier cells; the next one is taken when nothing of the size before can be reached."""

    def __post_init__(self) -> None:
        if self.num_samples < 1:
            raise ValueError(f"num_samples must be at least 1, got {self.num_samples}")
        if not self.discount >= 0:
            raise ValueError(f"discount must not be negative, got {self.discount}")
        if not self.max_range > 0:
            raise ValueError(f"max_range must be positive, got {self.max_range}")
        if not self.sizes or min(self.sizes) < 1:
            raise ValueError(f"sizes must be at least 1, got {self.sizes}")


class NextBestViewExplorer(GoalExplorer):
    """Goes to the view that promises most per way."""

    def __init__(self, params: NextBestViewParams = NextBestViewParams()) -> None:
        """Make an explorer with the given parameters."""
        super().__init__()
        self._params = params

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `Explorer`."""
        super().reset(robot, control_period, rng)
        self._rng = rng

    def _choose(self, survey: Survey) -> Goal | None:
        field = survey.field
        if field is None:
            return None
        clusters = frontier_clusters(survey.frontier)
        # Places that the robot failed to get to come last.
        for allowed_failures in (0, MAX_FAILURES):
            for size in self._params.sizes:
                large = [cells for cells in clusters if len(cells) >= size]
                goals = [
                    goal
                    for goal in self._sample(survey, field, large)
                    if self._num_failures(goal.frontier) <= allowed_failures
                ]
                if goals:
                    return self._best(survey, field, goals)
        return None

    def _sample(self, survey: Survey, field: TravelField, clusters: list[np.ndarray]) -> list[Goal]:
        """Draw viewpoints: one for each cluster, so that none is ever missed, and more around cells at random."""
        if not clusters:
            return []
        cells = np.concatenate(clusters)
        drawn = cells[self._rng.integers(len(cells), size=self._params.num_samples)]
        found = [goal_for(survey, field, targets) for targets in [*clusters, *drawn[:, None]]]
        return [goal for goal in found if goal is not None]

    def _best(self, survey: Survey, field: TravelField, goals: list[Goal]) -> Goal:
        """Return the goal of the greatest discounted gain."""
        places = np.array([goal.cell for goal in goals])
        gains = visible_gains(survey.grid, places, min(self._robot.lidar.range_max, self._params.max_range))
        # The logarithm orders alike and does not underflow at the far end of a large place.
        utilities = np.log(np.maximum(gains, 1e-9)) - self._params.discount * field.cost(places)
        return goals[int(np.argmax(utilities))]
