"""A next-best-view planner: sampled viewpoints, ray-cast gain, discounted by the length of the path.

The utility of a view is that of Bircher, Kamel, Alexis, Oleynikova, Siegwart, "Receding Horizon 'Next-Best-View'
Planner for 3D Exploration" (2016): `gain * exp(-discount * length)`. Views are sampled where they can gain anything,
from the candidates along frontiers, in place of a tree. Discount and time between decisions were tuned on training
worlds; `PUBLISHED` has those of the paper.
"""

import math
from dataclasses import dataclass

import numpy as np

from baselines.frontier.explorer import RuleExplorer, least
from baselines.frontier.nearest import CELL
from envs.estimation import Belief
from envs.navigation import Candidates, PlanningParams
from envs.robots import RobotParams

SPACING = 1.0
"""Frontiers longer than this have several viewpoints [m]."""


@dataclass(frozen=True, slots=True)
class NextBestViewParams:
    """How to sample views and to value them."""

    num_samples: int = 40
    """Viewpoints that are valued at most, drawn from all candidates."""
    discount: float = 0.15
    """Rate at which a gain loses its value along the path [1/m] (the paper's lambda)."""
    max_time: float = 4.0
    """Longest drive before views are valued anew [s]; inf keeps the robot to its goal."""
    sizes: tuple[int, ...] = (8, 3)
    """See `NearestParams`."""

    def __post_init__(self) -> None:
        if self.num_samples < 1:
            raise ValueError(f"num_samples must be at least 1, got {self.num_samples}")
        if not self.max_time > 0:
            raise ValueError(f"max_time must be positive, got {self.max_time}")
        if not self.discount >= 0:
            raise ValueError(f"discount must not be negative, got {self.discount}")
        if not self.sizes or min(self.sizes) < 1:
            raise ValueError(f"sizes must be at least 1, got {self.sizes}")


PUBLISHED = NextBestViewParams(discount=0.5, max_time=math.inf)
"""The discount of the paper's experiments, for views that are gone to to the end."""


class NextBestView:
    """Takes the view that promises most per length of path."""

    def __init__(self, params: NextBestViewParams = NextBestViewParams()) -> None:
        self._params = params

    def reset(self, robot: RobotParams, rng: np.random.Generator) -> None:
        self._rng = rng

    def __call__(self, candidates: Candidates, belief: Belief) -> int:
        values, drawn = np.full(len(candidates), np.inf), np.arange(len(candidates))
        if len(drawn) > self._params.num_samples:
            drawn = np.sort(self._rng.choice(drawn, self._params.num_samples, replace=False))
        # The logarithm orders alike and does not underflow at the far end of a large world.
        gains = np.log(np.maximum(candidates.visible[drawn], 1e-9))
        values[drawn] = self._params.discount * candidates.costs[drawn] - gains
        return least(values, candidates)


class NextBestViewExplorer(RuleExplorer):
    """Goes where `NextBestView` says."""

    def __init__(self, params: NextBestViewParams = NextBestViewParams()) -> None:
        planning = PlanningParams(min_lengths=tuple(CELL * size for size in params.sizes), max_extent=SPACING)
        super().__init__(NextBestView(params), max_time=params.max_time, planning=planning)
