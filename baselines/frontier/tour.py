"""Explorer that plans a short tour past all frontiers.

After Cao, Zhu, Choset, Zhang, "TARE: A Hierarchical Framework for Efficiently Exploring Complex 3D Environments", 2021,
but without separate local and global tours.
"""

import math

import numpy as np
from pydantic import NonNegativeFloat, PositiveInt
from pydantic.dataclasses import dataclass

from lidarnaut.baselines.frontier.open_tour import best_tours
from lidarnaut.baselines.frontier.rule_explorer import RuleExplorer
from lidarnaut.baselines.frontier.rules import MIN_LENGTHS
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.geometry.occupancy_grid import blocks_of
from lidarnaut.envs.navigation import COST_UNKNOWN, Candidates, Costmap, PlanningParams, travel_field
from lidarnaut.envs.robots import RobotParams

UNREACHABLE_LENGTH = 1e4
"""Path length assumed between stops without a connecting path [m]."""
SEARCH_MARGIN = 10.0
VIEWPOINT_SPACING = 1.0
"""Frontiers longer than this are split; each part has its own viewpoint [m]."""
MAX_CANDIDATES = 64
TOUR_PERIOD = 2.0
"""Maximum drive time before the next tour is planned [s]."""


@dataclass(frozen=True, slots=True)
class TourParams:
    """Parameters of the explorer that plans a tour past all frontiers."""

    cover: NonNegativeFloat = 0.4
    """Parts of a long frontier within this distance of a tour stop need no further stop; as a fraction of the lidar
    range."""
    max_cover: NonNegativeFloat = 3.0
    """Upper limit of the radius given by `cover` [m]."""
    max_stops: PositiveInt = 16
    """Maximum number of stops of a tour, lowest path cost first."""
    hysteresis: NonNegativeFloat = 1.0
    """The explorer changes to another frontier only if this shortens the tour by at least this length [m]."""


class Tour:
    """Scores each frontier by the negative length of a short tour that visits this frontier first."""

    def __init__(self, params: TourParams) -> None:
        self._params = params

    def reset(self, robot: RobotParams, rng: np.random.Generator) -> None:
        self._cover = min(self._params.cover * robot.lidar.range_max, self._params.max_cover)
        self._last: np.ndarray | None = None

    def __call__(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        stops, _ = cover(candidates.table, self._cover, self._params.max_stops, by_group=True)
        frontiers = candidates["frontier"]
        _, totals = best_tours(path_lengths(candidates.costmap, belief.pose[:2], candidates["viewpoint"][stops]))
        if self._last is not None:
            gaps = np.hypot(*(frontiers[stops] - self._last).T)
            same = int(np.argmin(gaps))
            if gaps[same] <= self._cover:
                totals[same] -= self._params.hysteresis
        self._last = frontiers[stops[np.argmin(totals)]]
        scores = np.full(len(candidates), -np.inf)
        scores[stops] = -totals
        return scores


class TourExplorer(RuleExplorer):
    """Drives to the first stop of a short tour past all frontiers.

    Short frontiers are ignored while a longer frontier is reachable.
    """

    def __init__(self, params: TourParams = TourParams()) -> None:
        planning = PlanningParams(min_lengths=(2 * MIN_LENGTHS[0], *MIN_LENGTHS), max_extent=VIEWPOINT_SPACING)
        super().__init__(Tour(params), max_time=TOUR_PERIOD, max_candidates=MAX_CANDIDATES, planning=planning)


def cover(table: np.ndarray, radius: float, max_stops: int, *, by_group: bool = False) -> tuple[list[int], np.ndarray]:
    """Select tour stops, in the order of path cost, until each frontier is within `radius` [m] of a stop.

    `table`: candidates (reachable frontiers) of all robots, shape (n,), dtype `CANDIDATE`. `by_group`: stops only count
    for parts of the same long frontier.

    Returns:
        Candidate indices of the stops; stop of each candidate, shape (n,), int64, -1 for none.
    """
    stops, stop_of = list[int](), np.full(len(table), -1)
    is_left = table["failures"] == table["failures"].min()
    for k in np.argsort(table["cost"], kind="stable").tolist():
        if is_left[k] and len(stops) < max_stops:
            gaps = np.hypot(*(table["frontier"] - table["frontier"][k]).T)
            is_near = is_left & (gaps <= radius)
            if by_group:
                is_near &= table["group"] == table["group"][k]
            stop_of[is_near], is_left = len(stops), is_left & ~is_near
            stops.append(k)
    return stops, stop_of


def path_lengths(costmap: Costmap, start: tuple[float, float], stops: np.ndarray) -> np.ndarray:
    """Return approximate path lengths between a start and n stops, shape (n + 1, n + 1), float64, symmetric [m].

    `start`: (x, y), map frame [m]. `stops`: shape (n, 2), float64, map frame [m]. Lengths are at most
    `UNREACHABLE_LENGTH`. The coarse grid may let paths through passages that are too narrow.
    """
    points, grid = np.vstack([start, stops]), costmap.grid
    reach, size = math.ceil(SEARCH_MARGIN / grid.resolution), max(1, int(costmap.params.robot_radius / grid.resolution))
    cells = grid.cells(points)
    top, left = np.maximum(cells.min(axis=0) - reach, 0)
    bottom, right = cells.max(axis=0) + reach + 1
    costs = blocks_of(costmap.costs[top:bottom, left:right], size, COST_UNKNOWN).min(axis=2)
    origin = grid.origin[0] + left * grid.resolution, grid.origin[1] + top * grid.resolution
    pooled = OccupancyGrid(np.zeros(costs.shape, dtype=np.int8), size * grid.resolution, origin)
    coarse, cells = Costmap(costs, pooled, costmap.params), pooled.cells(points)
    lengths = np.zeros((len(points), len(points)))
    for k in range(len(points) - 1):
        field = travel_field(coarse, (float(points[k, 0]), float(points[k, 1])))
        paths = np.full(len(points) - k - 1, np.inf) if field is None else field.cost(cells[k + 1 :])
        lengths[k, k + 1 :] = lengths[k + 1 :, k] = paths
    return np.minimum(lengths, UNREACHABLE_LENGTH)
