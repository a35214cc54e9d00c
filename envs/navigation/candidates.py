"""Frontier candidates: frontiers that the robot can get to, what is known of each, and what that is worth.

The search for paths expands from the robot, and stops when the cheapest candidates are known: what lies beyond them
costs nothing.
"""

import math
from dataclasses import dataclass

import numpy as np
import pydantic
from numba import njit
from pydantic import PositiveFloat

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import OCCUPIED_FROM
from lidarnaut.envs.geometry.lookup import record_type
from lidarnaut.envs.geometry.pose import wrap_angle
from lidarnaut.envs.navigation.astar import NO_GOAL, NUM_WAITING, SCALE, STRAIGHT, UNREACHED, begin, expand
from lidarnaut.envs.navigation.costmap import Costmap
from lidarnaut.envs.navigation.paths import walk_back
from lidarnaut.envs.navigation.views import (
    NUM_RAYS,
    NUM_SECTORS,
    SHARE_RADII,
    cast_view,
    cheapest_view,
    fill_sectors,
    unknown_share,
)
from lidarnaut.envs.robots import RobotParams

CANDIDATE = record_type(
    [
        ("viewpoint", np.float64, 2),  # from which the frontier is looked at, (x, y), map frame [m]
        ("frontier", np.float64, 2),  # the frontier cell that is seen from there, (x, y), map frame [m]
        ("cost", np.float64),  # length of the path to the viewpoint, weighted by nearness to obstacles [m]
        ("size", np.float64),  # length of the frontier, or of this part of it [m]
        ("group", np.int64),  # which frontier it is part of; long ones are split into several candidates
        ("group_size", np.float64),  # length of that frontier as a whole [m]
        ("visible", np.float64),  # unknown area in view, within the lidar's range and 8 m, up to occupied cells [m2]
        ("unknown", np.float64, len(SHARE_RADII)),  # share of the area within 1, 2, 4 m of the frontier
        # For each of 24 sectors around the viewpoint, counter-clockwise from the direction in which most unknown area
        # lies, the free range over the longest; then for each the share that is unknown and in view.
        ("sectors", np.float32, 2 * NUM_SECTORS),
        ("clearance", np.float64),  # from the viewpoint to obstacles, over the distance from which they cost nothing
        ("turn", np.float64),  # from the robot's heading to the beginning of the path, counter-clockwise [rad]
        ("age", np.float64),  # time for which there has been a candidate here [s]
        ("failures", np.int64),  # attempts to get here that failed
        ("goal", np.int64, 2),  # planning cell (row, column) of the viewpoint
        ("cell", np.int64, 2),  # that of the frontier
        ("travel", np.int64),  # cost in units of `search`
        ("span", np.int64, 2),  # first of `Candidates.frontier_cells` that is its own, and the one after its last
    ]
)
"""A candidate; its fields are what rules read, as `candidates["cost"]`."""
_FEATURES = """
visible unknown_1m unknown_2m unknown_4m cost cost_ratio rank turn size clearance age ahead left failures chosen
"""
FEATURES = tuple(_FEATURES.split())
"""Columns of the observation's candidates; see `ExploreFrontiersEnv`."""
NUM_FEATURES = len(FEATURES)
VISIBLE, UNKNOWN_1M, UNKNOWN_2M, UNKNOWN_4M, COST, COST_RATIO, RANK, TURN, *_ = range(NUM_FEATURES)
SIZE, CLEARANCE, AGE, AHEAD, LEFT, FAILURES, CHOSEN = range(TURN + 1, NUM_FEATURES)
HALF_AREA = 10.0
"""Visible unknown area that counts as one half [m2]."""
HALF_COST = 5.0
"""Travel cost that counts as one half [m]."""
HALF_SIZE = 2.0
"""Length of a frontier that counts as one half [m]."""
HALF_AGE = 60.0
"""Age of a frontier that counts as one half [s]."""
REACH = 16.0
"""Distance of a candidate that counts as one [m]."""
FAILED = 1e6
"""What is taken off the scores of candidates that failed."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Frontiers that the robot can get to, by increasing travel cost; `candidates["cost"]` has shape (k,)."""

    table: np.ndarray
    """Shape (k,), `CANDIDATE`."""
    chosen: int
    """Index of the candidate that the last drive was for; -1 if it is gone."""
    last_failed: bool
    """Whether that drive failed."""
    frontier_cells: np.ndarray
    """Shape (n, 2), int64: (row, column) of the planning cells of all frontiers."""
    costmap: Costmap
    """Costs on planning cells; its array is live."""

    @property
    def cells(self) -> tuple[np.ndarray, ...]:
        """For each candidate shape (n, 2), float64: centres of all its frontier cells (x, y) [m]; made when asked."""
        centers = self.costmap.grid.centers(self.frontier_cells)
        return tuple(centers[first:last] for first, last in self["span"].tolist())

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a field of all candidates; see `CANDIDATE`."""
        return self.table[name]

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.table)


def failed_last(scores: np.ndarray, candidates: Candidates) -> np.ndarray:
    """Return scores, shape (k,), with those of candidates that a drive has failed to get to behind all others."""
    return np.where(candidates["failures"] > 0, scores - FAILED, scores)


@pydantic.dataclasses.dataclass(frozen=True, slots=True)
class GainOverCost:
    """The ratio of gain and cost: `(visible + least_gain) / (cost + least_cost)`.

    After González-Baños and Latombe, "Navigation strategies for exploring indoor environments" (2002), who take
    `gain * exp(-cost)`; a ratio prefers the same near views, and does not give up on far ones.
    """

    least_gain: PositiveFloat = 0.3
    """Added to the visible unknown area [m2]: what looking at a frontier is worth where nothing seems to lie behind."""
    least_cost: PositiveFloat = 3.0
    """Added to the cost of the path [m]: the smaller, the more the nearest frontier counts."""

    def __call__(self, candidates: Candidates, belief: Belief) -> np.ndarray:
        """Return the logarithms of the ratios, shape (k,), float64."""
        ratios = np.log(candidates["visible"] + self.least_gain) - np.log(candidates["cost"] + self.least_cost)
        return failed_last(ratios, candidates)


def robot_features(robot: RobotParams) -> np.ndarray:
    """Return what policies see of a robot: shape (3,), float32; see `ExploreFrontiersEnv`."""
    sizes, halves = np.array([robot.lidar.range_max, robot.radius, robot.max_v]), np.array([10.0, 0.5, 1.0])
    return (sizes / (sizes + halves)).astype(np.float32)


@njit(cache=True, error_model="numpy")
def _view(joined, travel, members, tables, limit, is_complete):
    """Find the cheapest viewpoint of frontier cells, at the least view distance from which there is one.

    Returns row, column, index of the cell in view, travel cost; the index is -1 where the search has not found one.
    """
    for k in range(len(tables.views)):
        row, col, seen = cheapest_view(joined, travel, members, tables.views[k])
        if seen < 0:
            continue
        cost = travel[row + 1, col + 1]
        is_sure = is_complete or cost + (tables.detour if k else 0) <= limit
        return row, col, seen if is_sure else -1, cost
    return -1, -1, -1, UNREACHED


@njit(cache=True, error_model="numpy")
def _is_beyond(members, start, reach, limit):
    """Tell whether no cell within `reach` cells of any of some cells can be reached at a cost of `limit`."""
    nearest = np.int64(1 << 40)
    for k in range(len(members)):
        nearest = min(nearest, max(abs(members[k, 0] - start[0]), abs(members[k, 1] - start[1])))
    return (nearest - reach) * STRAIGHT * SCALE > limit


@njit(cache=True, error_model="numpy")
def find_candidates(joined, layer, expansion, entries, start, frontier, min_lengths, max_candidates, tables):
    """Find the frontiers that are cheapest to get to from a cell: at least `max_candidates`, if there are as many.

    `layer` holds costs, shape (height, width), uint8, and the `open_weights` of `_expand`, `frontier` the cells and
    parts of `split_groups`. A frontier has at least the first of `min_lengths` cells; the next one counts where none of
    those before can be reached. Returns records, `CANDIDATE`, of which the cells, travel cost, span and group are
    written (`group_size` in cells), and `entries`.
    """
    costs, open_weights = layer
    cells, parts = frontier
    height, width = joined.shape
    travel = expansion.travel.reshape(height + 2, width + 2)
    begin(expansion, entries, costs, start, NO_GOAL)
    found = np.empty(len(parts), dtype=CANDIDATE)
    is_settled = np.zeros(len(parts), dtype=np.bool_)
    num_found = 0
    limit = tables.first_limit
    for min_length in min_lengths:
        is_complete = False
        while True:
            if is_complete or not ((parts[:, 2] >= min_length) & ~is_settled).any():
                break
            entries = expand(expansion, entries, open_weights, costs, tables.weights, NO_GOAL, limit)
            is_complete = expansion.counters[NUM_WAITING] == 0
            for k in range(len(parts)):
                if parts[k, 2] < min_length or is_settled[k]:
                    continue
                members = cells[parts[k, 0] : parts[k, 1]]
                if not is_complete and _is_beyond(members, start, tables.views[-1], limit):
                    continue
                row, col, seen, cost = _view(joined, travel, members, tables, limit, is_complete)
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
    return found[:num_found], entries


@njit(cache=True, error_model="numpy")
def _clearance(joined, row, col, reach):
    """Return the distance from a cell to the nearest occupied one, at most `reach` [cells]."""
    height, width = joined.shape
    best = reach * reach
    for r in range(max(row - reach, 0), min(row + reach + 1, height)):
        for c in range(max(col - reach, 0), min(col + reach + 1, width)):
            if joined[r, c] >= OCCUPIED_FROM:
                best = min(best, (r - row) ** 2 + (c - col) ** 2)
    return math.sqrt(best)


@njit(cache=True, error_model="numpy")
def describe(raster, table, tables, frame, theta, now, past):
    """Complete the records of candidates, `table`, in metres and seconds.

    `raster` is `joined` and the predecessors, shape (height + 2, width + 2), uint8, of the search that found them;
    `frame` where the first column and row begin, map frame, and the side of a cell; `past` the frontiers of the
    candidates before (x, y), and since when they have been there, shape (n, 3); those that the robot did not get to,
    shape (m, 2); the one that was chosen last (x, y), NaN for none; and the distance up to which two are the same.

    Returns the frontiers for the next call, shape (k, 3); and which candidate was chosen last, -1 if it is gone.
    """
    joined, predecessor = raster
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
            out.unknown[i] = unknown_share(joined, row, col, SHARE_RADII[i] / side)
        outward = cast_view(joined, goal_row, goal_col, reach, free, unknown)
        out.visible = unknown.sum() * side * side
        fill_sectors(free, unknown, outward, reach, out.sectors)
        out.clearance = min(_clearance(joined, goal_row, goal_col, tables.inflation) / tables.inflation, 1.0)
        path = walk_back(predecessor, goal_row, goal_col)
        # On the viewpoint already, the path on is the one to what is to be seen.
        if path.shape[0] > 1:
            ahead = min(tables.heading_steps, path.shape[0] - 1)
            row, col = path[ahead, 0], path[ahead, 1]
        out.turn = wrap_angle(math.atan2(row - path[0, 0], col - path[0, 1]) - theta)
    return seen, last


@njit(cache=True, error_model="numpy")
def fill_features(table, chosen, x, y, theta, max_failures, features, sectors, gaps):
    """Write what policies see of candidates from a pose; see `ExploreFrontiersEnv`. Rows without a candidate are 0.

    `max_failures` is the number of failures that counts as one. `features`, shape (n, NUM_FEATURES), `sectors`, shape
    (n, 2 * NUM_SECTORS), and `gaps`, shape (n, n), all float32, are written.
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
        out[AHEAD] = min(max((c * dx + s * dy) / REACH, -1.0), 1.0)
        out[LEFT] = min(max((c * dy - s * dx) / REACH, -1.0), 1.0)
        out[FAILURES] = min(row.failures / max_failures, 1.0)
        for i in range(sectors.shape[1]):
            sectors[k, i] = row.sectors[i]
        for i in range(k):
            gap = math.hypot(row.frontier[0] - table[i].frontier[0], row.frontier[1] - table[i].frontier[1])
            gaps[k, i] = gaps[i, k] = gap / (gap + HALF_COST)
    if chosen >= 0:
        features[chosen, CHOSEN] = 1.0
