"""Exploration candidates: reachable frontiers, their features, and a scoring rule."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pydantic
from pydantic import PositiveFloat

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.files import explain_unknown
from lidarnaut.envs.geometry import OCCUPIED_FROM
from lidarnaut.envs.geometry.lookup import record_type
from lidarnaut.envs.geometry.pose import wrap_angle
from lidarnaut.envs.robots import RobotParams

from ..maps.costmap import Costmap
from ..maps.obstacles import NO_POINTS
from ..search.astar import NO_GOAL, NUM_WAITING, SCALE, STRAIGHT, UNREACHED, begin, expand
from ..search.paths import walk_back
from .views import NUM_RAYS, NUM_SECTORS, SHARE_RADII, cast_view, cheapest_view, fill_sectors, unknown_share

CANDIDATE = record_type(
    [
        ("viewpoint", np.float64, 2),
        ("frontier", np.float64, 2),
        ("cost", np.float64),
        ("size", np.float64),
        ("group", np.int64),
        ("group_size", np.float64),
        ("visible", np.float64),
        ("unknown", np.float64, len(SHARE_RADII)),
        ("sectors", np.float32, 2 * NUM_SECTORS),
        ("clearance", np.float64),
        ("turn", np.float64),
        ("age", np.float64),
        ("failures", np.int64),
        ("goal", np.int64, 2),  # internal, like the next fields
        ("cell", np.int64, 2),
        ("travel", np.int64),
        ("span", np.int64, 2),
    ]
)
"""Structured dtype of a candidate (reachable frontier); see `Candidates`."""
_FEATURES = """
visible unknown_1m unknown_2m unknown_4m cost cost_ratio rank turn size clearance age ahead left failures chosen
"""
FEATURES = tuple(_FEATURES.split())
"""Names of the policy inputs for each reachable frontier; see `ExploreFrontiersEnv`."""
NUM_FEATURES = len(FEATURES)
VISIBLE, UNKNOWN_1M, UNKNOWN_2M, UNKNOWN_4M, COST, COST_RATIO, RANK, TURN, *_ = range(NUM_FEATURES)
SIZE, CLEARANCE, AGE, AHEAD, LEFT, FAILURES, CHOSEN = range(TURN + 1, NUM_FEATURES)


class Markers(NamedTuple):
    """Goals, random trees, predicted floor and tour of a policy, for pictures and recordings, map frame [m]."""

    clusters: np.ndarray = NO_POINTS
    """Candidate goals, such as frontiers or centers of clusters, shape (n, 2)."""
    chosen: np.ndarray = NO_POINTS
    """Last chosen goal of each robot, shape (n, 2)."""
    points: np.ndarray = NO_POINTS
    """Points found in the last control period, before clustering, shape (n, 2)."""
    trees: Sequence[np.ndarray] = ()
    """Edges of each tree, from parent to child, shape (n, 2, 2): the global tree, then local trees."""
    predicted: np.ndarray = np.empty((0, 3))
    """Unknown cells that are predicted to be floor: centre (x, y) [m] and probability, shape (n, 3)."""
    side: float = 0.0
    """Side of predicted cells [m]."""
    tour: np.ndarray = NO_POINTS
    """Planned tour past all stops, shape (n, 2)."""

    @classmethod
    def of(cls, navigators: Iterable[Any]) -> "Markers":
        """Return the candidates and targets of `FrontierNavigator` objects."""
        clusters = np.concatenate([one.candidates["frontier"] for one in navigators])
        return cls(clusters, np.array([one.target for one in navigators if one.target]).reshape(-1, 2))


HALF_AREA = 10.0
"""Unknown area in view that yields a policy input of 0.5 [m2]: area / (area + `HALF_AREA`). Path cost [m], frontier
length [m] and age [s] are scaled in the same way, by the constants below."""
HALF_COST = 5.0
HALF_SIZE = 2.0
HALF_AGE = 60.0
OFFSET_SCALE = 16.0
"""Distance to a frontier, ahead or to the left, that yields the maximum policy input of 1 [m]."""
MAX_FAILURES = 3
"""Number of failed drives after which a frontier is ignored."""
FAILURE_PENALTY = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Reachable frontiers that the robot may explore next, sorted by increasing path cost.

    `candidates["cost"]` returns the field `cost`. For k candidates, the fields are:

    - `viewpoint`: position that sees the frontier (x, y), shape (k, 2), map frame [m].
    - `frontier`: frontier cell in view of the viewpoint (x, y), shape (k, 2), map frame [m].
    - `cost`: path length to the viewpoint, weighted by traversal costs [m].
    - `size`: length of the candidate [m]. Long frontiers are split into several candidates.
    - `group`: index of the whole frontier.
    - `group_size`: length of the whole frontier [m].
    - `visible`: unknown area in view of the viewpoint, within lidar range and 8 m [m2].
    - `unknown`: unknown share of discs of radius 1, 2 and 4 m around the frontier cell, shape (k, 3).
    - `sectors`: free ranges of 24 sectors around the viewpoint, then their unknown shares, as fractions, shape (k, 48);
      counter-clockwise from the mean direction of the unknown area.
    - `clearance`: distance from the viewpoint to obstacles divided by the inflation radius, at most 1.
    - `turn`: angle from the robot's heading to the start of the path, counter-clockwise [rad].
    - `age`: time since the frontier became a candidate [s].
    - `failures`: number of failed drives to the frontier.
    """

    table: np.ndarray
    """One record per candidate (reachable frontier), shape (k,), dtype `CANDIDATE`."""
    chosen: int
    """Index of the reachable frontier nearest to the last chosen frontier; -1 for none."""
    last_failed: bool
    frontier_cells: np.ndarray
    """Cells of all frontiers (row, column), shape (n, 2), int64."""
    costmap: Costmap
    """Costmap on which paths to the candidates were planned."""

    @property
    def cells(self) -> tuple[np.ndarray, ...]:
        """Centres of the frontier cells of each candidate: k arrays of shape (n, 2), map frame [m]."""
        centers = self.costmap.grid.centers(self.frontier_cells)
        return tuple(centers[first:last] for first, last in self["span"].tolist())

    def __getitem__(self, name: str) -> np.ndarray:
        """Return one column of the table of frontiers, such as `"cost"`. Raise ValueError for an unknown name."""
        if name not in (names := self.table.dtype.names or ()):
            raise ValueError(f"unknown field of candidates {explain_unknown(name, names[: names.index('goal')])}")
        return self.table[name]

    def __len__(self) -> int:
        return len(self.table)


def failed_last(scores: np.ndarray, candidates: Candidates) -> np.ndarray:
    """Return the scores of reachable frontiers, shape (k,), reduced by `FAILURE_PENALTY` after failed drives."""
    return np.where(candidates["failures"] > 0, scores - FAILURE_PENALTY, scores)


@pydantic.dataclasses.dataclass(frozen=True, slots=True)
class GainOverCost:
    """Score frontiers by unknown area divided by path cost: `(visible + least_gain) / (cost + least_cost)`.

    After González-Baños and Latombe, "Navigation strategies for exploring indoor environments" (2002). Their score
    `gain * exp(-cost)` discards distant candidates.
    """

    least_gain: PositiveFloat = 0.3
    """Constant added to the unknown area in view [m2], for positive scores."""
    least_cost: PositiveFloat = 3.0
    """Constant added to the path cost [m]. Smaller values favour near frontiers."""

    def __call__(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        """Return the logarithm of each candidate's score, with a penalty after failed drives, shape (k,), float64."""
        ratios = np.log(candidates["visible"] + self.least_gain) - np.log(candidates["cost"] + self.least_cost)
        return failed_last(ratios, candidates)


def robot_features(robot: RobotParams) -> np.ndarray:
    """Return a robot's lidar range, radius and maximum speed as policy inputs in [0, 1), shape (3,), float32."""
    sizes, halves = np.array([robot.lidar.range_max, robot.radius, robot.max_v]), np.array([10.0, 0.5, 1.0])
    return (sizes / (sizes + halves)).astype(np.float32)


@njit(cache=True, error_model="numpy")
def _view(occupancy, travel, members, tables, limit, is_complete):
    for k in range(len(tables.views)):
        row, col, seen = cheapest_view(occupancy, travel, members, tables.views[k])
        if seen < 0:
            continue
        cost = travel[row + 1, col + 1]
        is_sure = is_complete or cost + (tables.detour if k else 0) <= limit
        return row, col, seen if is_sure else -1, cost
    return -1, -1, -1, UNREACHED


@njit(cache=True, error_model="numpy")
def _is_beyond(members, start, reach, limit):
    nearest = np.int64(1 << 40)
    for k in range(len(members)):
        nearest = min(nearest, max(abs(members[k, 0] - start[0]), abs(members[k, 1] - start[1])))
    return (nearest - reach) * STRAIGHT * SCALE > limit


@njit(cache=True, error_model="numpy")
def find_candidates(occupancy, layer, expansion, queue, start, frontier, min_lengths, max_candidates, tables):
    """Find the reachable frontiers with the lowest path costs from the cell `start`.

    `layer`: costmap and cell weights for path search. `frontier`: frontier cells, and index ranges of frontiers from
    `split_groups`. `min_lengths`: minimum frontier lengths [cells], tried in order until a frontier is reachable.
    `max_candidates`: number of frontiers that ends the search. Returns partly filled `CANDIDATE` records and the search
    queue, perhaps enlarged.
    """
    costs, open_weights = layer
    cells, parts = frontier
    height, width = occupancy.shape
    travel = expansion.travel.reshape(height + 2, width + 2)
    begin(expansion, queue, costs, start, NO_GOAL)
    found = np.empty(len(parts), dtype=CANDIDATE)
    is_settled = np.zeros(len(parts), dtype=np.bool_)
    num_found = 0
    limit = tables.first_limit
    for min_length in min_lengths:
        is_complete = False
        while True:
            if is_complete or not ((parts[:, 2] >= min_length) & ~is_settled).any():
                break
            queue = expand(expansion, queue, open_weights, costs, tables.weights, NO_GOAL, limit)
            is_complete = expansion.counters[NUM_WAITING] == 0
            for k in range(len(parts)):
                if parts[k, 2] < min_length or is_settled[k]:
                    continue
                members = cells[parts[k, 0] : parts[k, 1]]
                if not is_complete and _is_beyond(members, start, tables.views[-1], limit):
                    continue
                row, col, seen, cost = _view(occupancy, travel, members, tables, limit, is_complete)
                if seen >= 0:
                    new = found[num_found]
                    new.goal[0], new.goal[1] = row, col
                    new.cell[0], new.cell[1] = members[seen, 0], members[seen, 1]
                    new.travel = cost
                    new.span[0], new.span[1], new.group_size, new.group = parts[k]
                    num_found += 1
                    is_settled[k] = True
            if (found["travel"][:num_found] <= limit - tables.detour).sum() >= max_candidates:
                break
            limit *= 2
        if num_found > 0:
            break
    return found[:num_found], queue


@njit(cache=True, error_model="numpy")
def _clearance(occupancy, row, col, reach):
    height, width = occupancy.shape
    best = reach * reach
    for r in range(max(row - reach, 0), min(row + reach + 1, height)):
        for c in range(max(col - reach, 0), min(col + reach + 1, width)):
            if occupancy[r, c] >= OCCUPIED_FROM:
                best = min(best, (r - row) ** 2 + (c - col) ** 2)
    return math.sqrt(best)


@njit(cache=True, error_model="numpy")
def describe(raster, table, tables, frame, theta, now, past):
    """Fill in the table of reachable frontiers: positions, features, ages and numbers of failed drives.

    `raster`: occupancy, and last move of the path to each cell. `frame`: origin (x, y), map frame, and cell side [m].
    `past`: known frontiers (x, y, time of first appearance), shape (n, 3); frontiers of failed drives, shape (m, 2);
    last chosen frontier; distance below which frontiers count as the same [m].

    Returns the known frontiers for the next call, shape (k, 3), and the index of the last chosen frontier, -1 for none.
    """
    occupancy, predecessor = raster
    left, low, side = frame
    before, failures, chosen, radius = past
    seen, last, least = np.empty((len(table), 3)), -1, radius
    reach, free, unknown = tables.view_reach, np.empty(NUM_RAYS), np.empty(NUM_RAYS)
    for k in range(len(table)):
        out = table[k]
        goal_row, goal_col = out.goal
        row, col = out.cell
        out.viewpoint[0], out.viewpoint[1] = left + (goal_col + 0.5) * side, low + (goal_row + 0.5) * side
        x, y = left + (col + 0.5) * side, low + (row + 0.5) * side
        out.frontier[0], out.frontier[1] = x, y
        since, out.failures = now, 0
        for j in range(len(before)):
            if math.hypot(before[j, 0] - x, before[j, 1] - y) <= radius:
                since = min(since, before[j, 2])
        for j in range(len(failures)):
            out.failures += math.hypot(failures[j, 0] - x, failures[j, 1] - y) <= radius
        gap = math.hypot(x - chosen[0], y - chosen[1])
        if gap <= least and (last < 0 or gap < least):
            last, least = k, gap
        seen[k, 0], seen[k, 1], seen[k, 2] = x, y, since
        out.age = now - since
        out.cost, out["size"] = out.travel * side / (STRAIGHT * SCALE), (out.span[1] - out.span[0]) * side
        out.group_size *= side
        for i in range(len(SHARE_RADII)):
            out.unknown[i] = unknown_share(occupancy, row, col, SHARE_RADII[i] / side)
        outward = cast_view(occupancy, goal_row, goal_col, reach, free, unknown)
        out.visible = unknown.sum() * side * side
        fill_sectors(free, unknown, outward, reach, out.sectors)
        out.clearance = min(_clearance(occupancy, goal_row, goal_col, tables.inflation) / tables.inflation, 1.0)
        path = walk_back(predecessor, goal_row, goal_col)
        # At the viewpoint, turn towards the frontier cell.
        if path.shape[0] > 1:
            ahead = min(tables.heading_steps, path.shape[0] - 1)
            row, col = path[ahead, 0], path[ahead, 1]
        out.turn = wrap_angle(math.atan2(row - path[0, 0], col - path[0, 1]) - theta)
    return seen, last


@njit(cache=True, error_model="numpy")
def fill_features(table, chosen, x, y, theta, features, sectors, gaps):
    """Write the scaled policy inputs of reachable frontiers, float32; see `ExploreFrontiersEnv`.

    Entries without a frontier are 0. Writes `features`, shape (n, NUM_FEATURES), `sectors`, shape (n, 2 * NUM_SECTORS),
    and `gaps`, distances between frontiers, shape (n, n).
    """
    c, s = math.cos(theta), math.sin(theta)
    features[:], sectors[:], gaps[:] = 0.0, 0.0, 0.0
    count = len(table)
    for k in range(count):
        row, out = table[k], features[k]
        dx, dy = row.frontier[0] - x, row.frontier[1] - y
        out[VISIBLE] = row.visible / (row.visible + HALF_AREA)
        for i in range(len(SHARE_RADII)):
            out[UNKNOWN_1M + i] = row.unknown[i]
        out[COST] = row.cost / (row.cost + HALF_COST)
        out[COST_RATIO] = (table[0].cost + 1.0) / (row.cost + 1.0)
        out[RANK] = k / len(features)
        out[TURN] = row.turn / math.pi
        out[SIZE] = row["size"] / (row["size"] + HALF_SIZE)
        out[CLEARANCE] = row.clearance
        out[AGE] = row.age / (row.age + HALF_AGE)
        out[AHEAD] = min(max((c * dx + s * dy) / OFFSET_SCALE, -1.0), 1.0)
        out[LEFT] = min(max((c * dy - s * dx) / OFFSET_SCALE, -1.0), 1.0)
        out[FAILURES] = min(row.failures / MAX_FAILURES, 1.0)
        for i in range(sectors.shape[1]):
            sectors[k, i] = row.sectors[i]
        for i in range(k):
            gap = math.hypot(row.frontier[0] - table[i].frontier[0], row.frontier[1] - table[i].frontier[1])
            gaps[k, i] = gaps[i, k] = gap / (gap + HALF_COST)
    if chosen >= 0:
        features[chosen, CHOSEN] = 1.0
