"""Choice of frontiers by short tours over an expected map: known floor, and predicted floor behind the frontiers.

The first part of a tour is certain, the rest is expected; the choice is made anew as the map grows.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from lidarnaut.baselines.frontier.expected_map import ExpectedMap, Predict, expect_map, spread
from lidarnaut.baselines.frontier.open_tour import tour_length
from lidarnaut.baselines.oracle.cover_tour import Cover, count_bits, search_tour
from lidarnaut.baselines.oracle.cover_viewpoints import views_from
from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry.distance_transform import MAX_REACH, squared_distances
from lidarnaut.envs.navigation import Candidates, GainOverCost, failed_last
from lidarnaut.envs.navigation.search.astar import SCALE
from lidarnaut.envs.robots import RobotParams

SPACINGS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 8.0)
"""Distances between viewpoints, tried in order until there are few enough [m]."""
MAX_TRIED = 3
"""Maximum number of viewpoints whose view is computed, divided by the allowed number: most see nothing unknown."""
UNCONNECTED = 1e4
"""Path length between points that no path connects [m]."""
START_REACH = 2
"""Robot and frontiers may lie this many cells beyond the robot's radius from a traversable cell."""


@dataclass(frozen=True, slots=True)
class ExpectedTourParams:
    """Parameters of tours over an expected map."""

    reach: PositiveFloat = 2.0
    """Predicted floor counts up to this distance from known floor [m]."""
    threshold: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    """Minimum probability of unknown cells that count as floor."""
    may_leave: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.02
    """Fraction of known and expected floor that a tour need not see."""
    bonus: NonNegativeFloat = 0.5
    """Reduction of the length of the tour that goes on to the last chosen frontier [m]."""
    num_best: PositiveInt = 6
    """Number of compared frontiers with the highest ratio of unknown area to path cost."""
    num_nearest: PositiveInt = 3
    """Number of compared frontiers with the lowest path cost."""
    max_range: PositiveFloat = 4.0
    """Maximum distance at which expected floor counts as seen, limited by the lidar's range [m]."""
    num_samples: PositiveInt = 1024
    """Maximum number of expected cells that stand for all."""
    max_viewpoints: PositiveInt = 160
    """Maximum number of viewpoints of tours."""
    num_rounds: PositiveInt = 6
    """Number of attempts to shorten a tour."""
    stop_cost: NonNegativeFloat = 0.1
    """Cost of a stop on a tour, expressed as path length [m]."""


class _Places(NamedTuple):
    """Places that tours visit: viewpoints, then frontiers, then the robot."""

    lengths: np.ndarray
    """Path lengths between places, shape (n, n), float64 [m]."""
    predecessors: np.ndarray
    """Last place before place j on the path from i, shape (n, n), int32."""
    sees: np.ndarray
    """Samples of expected floor in view, one bit per sample, shape (n, words), uint64."""
    frontiers: np.ndarray
    """Indices of the frontiers; -1 for frontiers that no traversable cell is near."""
    robot: int
    points: np.ndarray
    """Positions, shape (n, 2), map frame [m]."""


@njit(cache=True, error_model="numpy")
def _path_lengths(weights, owners, lengths, num_places):
    """Return path lengths between places [free cells], and the last place before the second one.

    Neighbouring places, whose cells touch, are connected; then Floyd's algorithm (1962).
    """
    between = np.full((num_places, num_places), np.inf)
    before = np.empty((num_places, num_places), dtype=np.int32)
    for i in range(num_places):
        between[i, i], before[i] = 0.0, i
    height, width = weights.shape
    for row in range(height):
        for col in range(width):
            for i, j in ((row + 1, col), (row, col + 1)):
                if i == height or j == width or owners[row, col] < 0 or owners[i, j] < 0:
                    continue
                a, b = owners[row, col], owners[i, j]
                length = lengths[row, col] + lengths[i, j] + 0.5 * (weights[row, col] + weights[i, j]) / SCALE
                if a != b and length < between[a, b]:
                    between[a, b] = between[b, a] = length
    for middle in range(num_places):
        for i in range(num_places):
            if i == middle or between[i, middle] == np.inf:
                continue
            for j in range(num_places):
                through = between[i, middle] + between[middle, j]
                if through < between[i, j]:
                    between[i, j], before[i, j] = through, before[middle, j]
    return between, before


@njit(cache=True, error_model="numpy")
def _nearest_traversable(weights, cells, reach):
    """Return the traversable cell nearest to each of `cells`, at most `reach` rows and columns away; -1, -1 for none.

    `cells` and result: rows and columns, shape (n, 2). `weights`: weights of path search, 0 for blocked cells.
    """
    found = np.full(cells.shape, -1, dtype=np.int64)
    for k in range(len(cells)):
        least, (row, col) = reach * reach + 1, cells[k]
        for i in range(max(row - reach, 0), min(row + reach + 1, weights.shape[0])):
            for j in range(max(col - reach, 0), min(col + reach + 1, weights.shape[1])):
                squared = (i - row) ** 2 + (j - col) ** 2
                if weights[i, j] > 0 and squared < least:
                    least, found[k, 0], found[k, 1] = squared, i, j
    return found


@njit(cache=True, error_model="numpy")
def _tours(cover, firsts, target, num_rounds, rng):
    """Return short tours (indices) that begin at each of `firsts` and see `target` samples, and their lengths [m]."""
    tours, totals = [np.array([first]) for first in firsts], np.empty(len(firsts))
    for k in range(len(firsts)):
        tours[k], _ = search_tour(cover, cover.sees[firsts[k]], target, tours[k], num_rounds, rng)
        totals[k] = tour_length(cover.lengths, tours[k])
    return tours, totals


class ExpectedTour:
    """Rule that scores frontiers: minus the length of a short tour that begins there and sees the expected floor."""

    def __init__(self, predict: Predict, params: ExpectedTourParams = ExpectedTourParams()) -> None:
        self.predict, self.params = predict, params
        self._gain_over_cost = GainOverCost()

    def reset(self, robot: RobotParams, rng: np.random.Generator) -> None:
        self._robot, self._rng = robot, rng
        self.expected: ExpectedMap | None = None
        """Expected map of the last choice; None if it had a single frontier."""
        self.tours: dict[int, np.ndarray] = {}
        """Tours that began at each compared frontier of the last choice, by index: shape (n, 2), map frame [m]."""
        if hasattr(self.predict, "reset"):
            self.predict.reset()

    def __call__(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        scores, compared = np.full(len(candidates), -np.inf), self._shortlist(candidates, belief)
        self.expected, self.tours = None, {}
        scores[compared] = -self._totals(candidates, belief, compared) if len(compared) > 1 else 0.0
        if candidates.chosen >= 0:
            scores[candidates.chosen] += self.params.bonus
        return failed_last(scores, candidates)

    def _shortlist(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        best = np.argsort(-self._gain_over_cost(candidates, belief), kind="stable")[: self.params.num_best]
        shortlist = {*best.tolist(), *range(min(self.params.num_nearest, len(candidates)))}  # sorted by cost
        if candidates.chosen >= 0:
            shortlist.add(candidates.chosen)
        failures = candidates["failures"]
        return np.array([k for k in sorted(shortlist) if failures[k] == failures.min()], dtype=np.int64)

    def _totals(self, candidates: Candidates, belief: Belief, compared: np.ndarray) -> np.ndarray:
        """Return the lengths of tours from the robot by way of each compared frontier [m]."""
        params, costs = self.params, candidates["cost"][compared]
        prediction = self.predict(belief.grid)
        self.expected = expected = expect_map(candidates.costmap, prediction, params.reach, params.threshold)
        cells = np.argwhere(expected.expected > 0.0)
        if len(cells) == 0:
            return costs
        samples = cells
        if len(cells) > params.num_samples:
            samples = cells[np.sort(self._rng.choice(len(cells), params.num_samples, replace=False))]
        points = np.vstack([candidates["viewpoint"][compared], [belief.pose[:2]]])
        places = self._places(expected, samples, points)
        if places is None:
            return costs
        may_leave = params.may_leave * (expected.num_known + len(cells)) * len(samples) / len(cells)
        reachable = places.lengths[places.robot] < UNCONNECTED
        in_view = int(count_bits(np.bitwise_or.reduce(places.sees[reachable], axis=0)))
        cover = Cover(places.lengths + params.stop_cost, places.predecessors, places.sees)
        has_place = places.frontiers >= 0
        lengths = np.full(len(compared), UNCONNECTED)
        firsts, target = places.frontiers[has_place], max(int(in_view - may_leave), 0)
        tours, lengths[has_place] = _tours(cover, firsts, target, params.num_rounds, self._rng)
        self.tours = {k: places.points[tour] for k, tour in zip(compared[has_place].tolist(), tours, strict=True)}
        return costs + lengths

    def _places(self, expected: ExpectedMap, samples: np.ndarray, points: np.ndarray) -> _Places | None:
        """Return the places of tours; None without a traversable cell near the robot, the last of `points`."""
        reach = round(self._robot.radius / expected.side) + START_REACH
        ends = _nearest_traversable(expected.weights, expected.cells(points), reach)
        is_placed = ends[:, 0] >= 0
        if not is_placed[-1]:
            return None
        sight = min(self.params.max_range, self._robot.lidar.range_max) / expected.side
        viewpoints, views = self._viewpoints(expected, samples, sight)
        cells = np.vstack([viewpoints, ends[is_placed]])
        sees = np.vstack([views, views_from(expected.clear, ends[is_placed], sight, samples)])
        owners, lengths = spread(expected.weights, cells, math.inf, False)
        between, before = _path_lengths(expected.weights, owners, lengths, len(cells))
        # Of places in one cell, the first one stands for all.
        taken = np.full(len(points), -1, dtype=np.int64)
        taken[is_placed] = owners[tuple(ends[is_placed].T)]
        between = np.minimum(between * expected.side, UNCONNECTED)
        return _Places(between, before, sees, taken[:-1], int(taken[-1]), expected.centers(cells))

    def _viewpoints(self, expected: ExpectedMap, samples: np.ndarray, sight: float) -> tuple[np.ndarray, np.ndarray]:
        """Return cells on a lattice that see samples, shape (n, 2), int64, and their views, as `views_from` does."""
        most, reach = self.params.max_viewpoints, min(int(sight), MAX_REACH)
        is_near = squared_distances(expected.expected > 0.0, reach) <= reach**2
        cells = np.argwhere((expected.weights > 0) & is_near)
        # Of each square, the first cell counts: one away from walls.
        cells = cells[np.argsort(expected.weights[tuple(cells.T)] // SCALE, kind="stable")]
        for spacing in SPACINGS:
            squares = cells // max(1, round(spacing / expected.side))
            first = np.unique(squares[:, 0] * expected.weights.shape[1] + squares[:, 1], return_index=True)[1]
            if len(first) > MAX_TRIED * most and spacing != SPACINGS[-1]:
                continue
            viewpoints = cells[np.sort(first)]
            views = views_from(expected.clear, viewpoints, sight, samples)
            is_useful = views.any(axis=1)
            if np.count_nonzero(is_useful) <= most:
                break
        return viewpoints[is_useful][:most], views[is_useful][:most]
