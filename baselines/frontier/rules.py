"""Rules of a line or two, and the explorers that go where they say."""

import math

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from lidarnaut.baselines.frontier.explorer import COMMITTED, RuleExplorer
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.navigation import Candidates, GainOverCost, PlanningParams, failed_last
from lidarnaut.envs.robots import RobotParams

CELL = 0.05
"""Side of the cells that sizes of published rules count [m]."""
LENGTHS = (8 * CELL, 3 * CELL)
"""Least length of a frontier [m], and of one where nothing else can be reached: planning cells of 0.1 m round it up."""


def nearest(candidates: Candidates, belief: Belief) -> np.ndarray:
    """Prefer the candidate that is cheapest to get to (Yamauchi 1997): tuned rules beat it by a few percent."""
    return failed_last(-candidates["cost"], candidates)


class NearestExplorer(RuleExplorer):
    """Goes to the frontier that is cheapest to get to."""

    def __init__(self) -> None:
        super().__init__(nearest, max_candidates=4, planning=PlanningParams(min_lengths=LENGTHS))


def greedy_gain(candidates: Candidates, belief: Belief) -> np.ndarray:
    """Prefer the frontier with the most unknown area in view, however far it is; of equal ones the cheaper."""
    return failed_last(candidates["visible"], candidates)


class GreedyGainExplorer(RuleExplorer):
    """Goes where `greedy_gain` says."""

    def __init__(self) -> None:
        super().__init__(greedy_gain, max_time=COMMITTED)


class GainOverCostExplorer(RuleExplorer):
    """Goes where `GainOverCost` says, and asks it anew every four seconds."""

    def __init__(self, params: GainOverCost = GainOverCost()) -> None:
        super().__init__(params)


@dataclass(frozen=True, slots=True)
class ExploreLite:
    """The cost of explore_lite (Horner, "Map-merging for multi-robot system", 2016; ROS package m-explore).

    Each frontier is a group of touching cells; the cheapest one, by `potential_scale * distance - gain_scale * size`,
    is the goal, and it is chosen anew every few seconds, so that the goal may change during a drive. As in that package
    both terms are multiplied by the map's resolution; the distance is the straight one to the nearest cell. Three
    things are ours: the robot goes to the viewpoint whose frontier lies nearest to the centroid, which may itself lie
    inside an obstacle; when no frontier of the least size is left, smaller ones count; and what cannot be reached does
    not. Defaults: the package's launch file, but for `gain_scale`, which was tuned on training worlds.
    """

    potential_scale: NonNegativeFloat = 3.0
    """What a metre of distance costs."""
    gain_scale: NonNegativeFloat = 0.3
    """What a cell of size is worth; 1 in the launch file."""

    def __call__(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        x, y, _ = belief.pose
        costs, all_cells, groups = np.empty(len(candidates)), candidates.cells, candidates["group"]
        for group in np.unique(groups):
            own = np.flatnonzero(groups == group)
            cells = np.concatenate([all_cells[k] for k in own])
            distance = np.hypot(*(cells - (x, y)).T).min()
            cost = self.potential_scale * distance - self.gain_scale * candidates["group_size"][own[0]] / CELL
            # Of the parts of a frontier, the one in the middle.
            costs[own] = cost * CELL + 1e-6 * np.hypot(*(candidates["frontier"][own] - cells.mean(axis=0)).T)
        return failed_last(-costs, candidates)


class ExploreLiteExplorer(RuleExplorer):
    """Goes where `ExploreLite` says, asked as often as the package's planner, to frontiers of its least length."""

    def __init__(self, params: ExploreLite = ExploreLite()) -> None:
        # Longer frontiers have several candidates, of which the one in the middle is taken.
        planning = PlanningParams(min_lengths=(0.75, LENGTHS[-1]), max_extent=0.5)
        super().__init__(params, max_time=1.0 / 0.33, planning=planning)


@dataclass(frozen=True, slots=True)
class NextBestViewParams:
    """How to sample views and to value them. Discount and time were tuned on training worlds."""

    num_samples: PositiveInt = 40
    """Viewpoints that are valued at most, drawn from all candidates."""
    discount: NonNegativeFloat = 0.15
    """Rate at which a gain loses its value along the path [1/m] (the paper's lambda; 0.5 there)."""
    max_time: PositiveFloat = 4.0
    """Longest drive before views are valued anew [s]; inf, as in the paper, keeps the robot to its goal."""


class NextBestView:
    """Prefers the view that promises most per length of path: sampled viewpoints, ray-cast gain, discounted.

    The utility of a view is that of Bircher, Kamel, Alexis, Oleynikova, Siegwart, "Receding Horizon 'Next-Best-View'
    Planner for 3D Exploration" (2016): `gain * exp(-discount * length)`. Views are sampled where they can gain
    anything, from the candidates along frontiers, in place of a tree.
    """

    def __init__(self, params: NextBestViewParams) -> None:
        self._params = params

    def reset(self, robot: RobotParams, rng: np.random.Generator) -> None:
        self._rng = rng

    def __call__(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        scores, drawn = np.full(len(candidates), -np.inf), np.arange(len(candidates))
        if len(drawn) > self._params.num_samples:
            drawn = np.sort(self._rng.choice(drawn, self._params.num_samples, replace=False))
        # The logarithm orders alike and does not underflow at the far end of a large world.
        gains = np.log(np.maximum(candidates["visible"][drawn], 1e-9))
        scores[drawn] = gains - self._params.discount * candidates["cost"][drawn]
        return failed_last(scores, candidates)


class NextBestViewExplorer(RuleExplorer):
    """Goes where `NextBestView` says; frontiers longer than a metre have several viewpoints."""

    def __init__(self, params: NextBestViewParams = NextBestViewParams()) -> None:
        planning = PlanningParams(min_lengths=LENGTHS, max_extent=1.0)
        super().__init__(NextBestView(params), max_time=params.max_time, planning=planning)


PUBLISHED_LITE = ExploreLite(gain_scale=1.0)
"""The package's launch file."""
PUBLISHED_VIEWS = NextBestViewParams(discount=0.5, max_time=math.inf)
"""The paper's experiments, for views that are gone to to the end."""
