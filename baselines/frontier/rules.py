"""Functions that score frontiers, and explorers that use the scores."""

import math
from dataclasses import replace

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat
from pydantic.dataclasses import dataclass

from lidarnaut.baselines.frontier.rule_explorer import COMMITTED, RuleExplorer
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.navigation import Candidates, GainOverCost, PlanningParams, failed_last
from lidarnaut.envs.robots import RobotParams

CELL = 0.05
"""Cell side that converts published frontier sizes (in cells) to lengths [m]."""
MIN_LENGTHS = (8 * CELL, 3 * CELL)
"""Minimum frontier lengths [m], tried in order until a frontier is reachable."""
MAX_VIEWPOINTS = 40
"""Maximum number of viewpoints that the next-best-view explorer scores, sampled at random."""


def nearest(candidates: Candidates, belief: Belief) -> np.ndarray:
    """Score reachable frontiers by negative path cost (Yamauchi 1997)."""
    return failed_last(-candidates["cost"], candidates)


class NearestExplorer(RuleExplorer):
    """Drives to the frontier with the lowest path cost. Frontiers shorter than the robot come last (Yamauchi 1997)."""

    def __init__(self) -> None:
        super().__init__(nearest, max_candidates=4)

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        least = max(MIN_LENGTHS[0], 2.0 * robot.radius)
        self.planning = replace(self.planning, min_lengths=(least, MIN_LENGTHS[1]))
        super().reset(robot, control_period, rng)


def greedy_gain(candidates: Candidates, belief: Belief) -> np.ndarray:
    """Score reachable frontiers by unknown area in view [m2]."""
    return failed_last(candidates["visible"], candidates)


class GreedyGainExplorer(RuleExplorer):
    """Drives to the frontier with the most unknown area in view."""

    def __init__(self) -> None:
        super().__init__(greedy_gain, max_time=COMMITTED)


class GainOverCostExplorer(RuleExplorer):
    """Chooses frontiers by unknown area divided by path cost, every four seconds."""

    def __init__(self, params: GainOverCost = GainOverCost()) -> None:
        super().__init__(params)


@dataclass(frozen=True, slots=True)
class ExploreLite:
    """Frontier score of the ROS package explore_lite (Horner, "Map-merging for multi-robot system", 2016).

    The cost (negative score) is `potential_scale * distance - gain_scale * size`, with the straight distance to the
    nearest frontier cell [m] and the number of 5 cm cells. Unlike in the package, the goal is the viewpoint nearest to
    the centroid, and small frontiers count if no larger one is reachable. Defaults are from the launch file, except for
    `gain_scale`.
    """

    potential_scale: NonNegativeFloat = 3.0
    """Cost of a frontier per metre of distance [1/m]."""
    gain_scale: NonNegativeFloat = 0.3
    """Cost reduction per frontier cell of 5 cm. The ROS package uses 1."""

    def __call__(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        x, y, _ = belief.pose
        costs, all_cells, groups = np.empty(len(candidates)), candidates.cells, candidates["group"]
        for group in np.unique(groups):
            own = np.flatnonzero(groups == group)
            cells = np.concatenate([all_cells[k] for k in own])
            distance = np.hypot(*(cells - (x, y)).T).min()
            cost = self.potential_scale * distance - self.gain_scale * candidates["group_size"][own[0]] / CELL
            costs[own] = cost * CELL + 1e-6 * np.hypot(*(candidates["frontier"][own] - cells.mean(axis=0)).T)
        return failed_last(-costs, candidates)


class ExploreLiteExplorer(RuleExplorer):
    """Explorer with the frontier scores of the ROS package explore_lite."""

    def __init__(self, params: ExploreLite = ExploreLite()) -> None:
        planning = PlanningParams(min_lengths=(0.75, MIN_LENGTHS[-1]), max_extent=0.5)
        super().__init__(params, max_time=1.0 / 0.33, planning=planning)


@dataclass(frozen=True, slots=True)
class NextBestViewParams:
    """Parameters of next-best-view exploration; `discount` and `max_time` were tuned on training worlds."""

    discount: NonNegativeFloat = 0.15
    """Discount rate [1/m] in the score of a viewpoint: visible unknown area x exp(-discount x path length); 0.5 in the
    paper."""
    max_time: PositiveFloat = 4.0
    """Maximum drive time before the next choice of a viewpoint [s]; infinite in the paper."""


class NextBestView:
    """Score of viewpoints: unknown area in view, discounted by path length, `area * exp(-discount * length)`.

    Bircher, Kamel, Alexis, Oleynikova, Siegwart, "Receding Horizon 'Next-Best-View' Planner for 3D Exploration" (2016),
    with viewpoints at frontiers instead of in a random tree.
    """

    def __init__(self, params: NextBestViewParams) -> None:
        self._params = params

    def reset(self, robot: RobotParams, rng: np.random.Generator) -> None:
        self._rng = rng

    def __call__(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        scores, drawn = np.full(len(candidates), -np.inf), np.arange(len(candidates))
        if len(drawn) > MAX_VIEWPOINTS:
            drawn = np.sort(self._rng.choice(drawn, MAX_VIEWPOINTS, replace=False))
        # Logarithms avoid underflow in large worlds.
        gains = np.log(np.maximum(candidates["visible"][drawn], 1e-9))
        scores[drawn] = gains - self._params.discount * candidates["cost"][drawn]
        return failed_last(scores, candidates)


class NextBestViewExplorer(RuleExplorer):
    """Drives to the viewpoint with the most unknown area in view, discounted by path length."""

    def __init__(self, params: NextBestViewParams = NextBestViewParams()) -> None:
        planning = PlanningParams(min_lengths=MIN_LENGTHS, max_extent=1.0)
        super().__init__(NextBestView(params), max_time=params.max_time, planning=planning)


PUBLISHED_LITE = ExploreLite(gain_scale=1.0)
PUBLISHED_VIEWS = NextBestViewParams(discount=0.5, max_time=math.inf)
