"""The cost of explore_lite (Horner, "Map-merging for multi-robot system", 2016; ROS package m-explore).

Each frontier is a group of touching cells; the cheapest one, by `potential_scale * distance - gain_scale * size`, is
the goal, and it is chosen anew every few seconds, so that the goal may change during a drive. As in that package both
terms are multiplied by the map's resolution, which changes their sum's unit and not their order; the distance is the
straight one to the nearest cell. Three things are ours: the robot goes to the viewpoint whose frontier lies nearest to
the centroid, which may itself lie inside an obstacle; when no frontier of the least size is left, smaller ones count;
and what cannot be reached does not.
"""

from dataclasses import dataclass

import numpy as np

from baselines.frontier.explorer import RuleExplorer, least
from baselines.frontier.nearest import CELL
from envs.estimation import Belief
from envs.navigation import Candidates, PlanningParams

SPACING = 0.5
"""Frontiers longer than this have several candidates, of which the one in the middle is taken [m]."""


@dataclass(frozen=True, slots=True)
class ExploreLiteParams:
    """Defaults: the package's launch file, but for `gain_scale`, which was tuned on training worlds."""

    planner_frequency: float = 0.33
    """How often the goal is chosen anew [1/s]."""
    potential_scale: float = 3.0
    """What a metre of distance costs."""
    gain_scale: float = 0.3
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


PUBLISHED = ExploreLiteParams(gain_scale=1.0)
"""The package's launch file."""


class ExploreLite:
    """Takes the frontier with the least of distance minus size."""

    def __init__(self, params: ExploreLiteParams = ExploreLiteParams()) -> None:
        self._params = params

    def __call__(self, candidates: Candidates, belief: Belief) -> int:
        params, x, y = self._params, belief.pose.x, belief.pose.y
        values, all_cells = np.empty(len(candidates)), candidates.cells
        for group in np.unique(candidates.groups):
            own = np.flatnonzero(candidates.groups == group)
            cells = np.concatenate([all_cells[k] for k in own])
            distance = np.hypot(*(cells - (x, y)).T).min()
            cost = params.potential_scale * distance - params.gain_scale * candidates.group_sizes[own[0]] / CELL
            # Of the parts of a frontier, the one in the middle.
            values[own] = cost * CELL + 1e-6 * np.hypot(*(candidates.frontiers[own] - cells.mean(axis=0)).T)
        return least(values, candidates)


class ExploreLiteExplorer(RuleExplorer):
    """Goes where `ExploreLite` says."""

    def __init__(self, params: ExploreLiteParams = ExploreLiteParams()) -> None:
        lengths = params.min_frontier_size, CELL * params.min_cells
        planning = PlanningParams(min_lengths=lengths, max_extent=SPACING)
        super().__init__(ExploreLite(params), max_time=1.0 / params.planner_frequency, planning=planning)
