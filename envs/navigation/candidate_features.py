"""What rules and policies know of each candidate. Kernels, and the record that rules get."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from envs.geometry.pose import wrap_angle
from envs.navigation.astar import SCALE, STRAIGHT
from envs.navigation.candidate_views import (
    NUM_RAYS,
    NUM_SECTORS,
    SHARE_RADII,
    cast_view,
    fill_sectors,
    ray_directions,
    unknown_share,
)
from envs.navigation.costmap import Costmap
from envs.navigation.frontiers import OCCUPIED_FROM
from envs.navigation.paths import walk_back
from envs.robots import RobotParams

FEATURES = (
    "visible",
    "unknown_1m",
    "unknown_2m",
    "unknown_4m",
    "cost",
    "cost_ratio",
    "rank",
    "turn",
    "size",
    "clearance",
    "age",
    "ahead",
    "left",
    "failures",
    "chosen",
)
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
CANDIDATE = np.dtype(
    [
        ("viewpoint", np.float64, 2),
        ("frontier", np.float64, 2),
        ("cost", np.float64),
        ("size", np.float64),
        ("visible", np.float64),
        ("unknown", np.float64, len(SHARE_RADII)),
        ("sectors", np.float32, 2 * NUM_SECTORS),
        ("clearance", np.float64),
        ("turn", np.float64),
        ("age", np.float64),
        ("failures", np.int64),
    ]
)
"""A candidate in metres and seconds, map frame; see `Candidates`."""


def robot_features(robot: RobotParams) -> np.ndarray:
    """Return what policies see of a robot: shape (3,), float32; see `ExploreFrontiersEnv`."""
    sizes, halves = np.array([robot.lidar.range_max, robot.radius, robot.max_v]), np.array([10.0, 0.5, 1.0])
    return (sizes / (sizes + halves)).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Frontiers that the robot can get to, by increasing travel cost; k of them. Map frame, metres."""

    viewpoints: np.ndarray
    """Shape (k, 2), float64: viewpoint of the frontier (x, y) [m]."""
    frontiers: np.ndarray
    """Shape (k, 2), float64: the frontier cell that is seen from there (x, y) [m]."""
    costs: np.ndarray
    """Shape (k,), float64: length of the path to the viewpoint, each step weighted by nearness to obstacles [m]."""
    sizes: np.ndarray
    """Shape (k,), float64: length of the frontier, or of this part of it [m]."""
    groups: np.ndarray
    """Shape (k,), int64: which frontier it is part of; long frontiers are split into several candidates."""
    group_sizes: np.ndarray
    """Shape (k,), float64: length of that frontier as a whole [m]."""
    visible: np.ndarray
    """Shape (k,), float64: unknown area in view of the viewpoint, within the lidar's range and 8 m [m2]; nothing but
    occupied cells blocks the view."""
    unknown: np.ndarray
    """Shape (k, 3), float64: share of the area within 1 m, 2 m and 4 m of the frontier that is unknown."""
    sectors: np.ndarray
    """Shape (k, 48), float32: for each of 24 sectors around the viewpoint, counter-clockwise from the direction in
    which most unknown area lies, the free range over the longest; then for each the share that is unknown and in view.
    """
    clearances: np.ndarray
    """Shape (k,), float64: distance from the viewpoint to obstacles, over that from which they cost nothing."""
    turns: np.ndarray
    """Shape (k,), float64: from the robot's heading to the beginning of the path, counter-clockwise [rad]."""
    ages: np.ndarray
    """Shape (k,), float64: time for which there has been a candidate here [s]."""
    failures: np.ndarray
    """Shape (k,), int64: attempts to get here that failed."""
    chosen: int
    """Index of the candidate that the last drive was for; -1 if it is gone."""
    last_failed: bool
    """Whether that drive failed."""
    frontier_cells: np.ndarray
    """Shape (n, 2), int64: (row, column) of the planning cells of all frontiers..."""
    spans: np.ndarray
    """...and shape (k, 2), int64: the first of them that is the candidate's, and the one after its last."""
    costmap: Costmap
    """Costs on planning cells; its array is live."""

    @property
    def cells(self) -> tuple[np.ndarray, ...]:
        """For each candidate shape (n, 2), float64: centres of all its frontier cells (x, y) [m]; made when asked."""
        centers = self.costmap.grid.centers(self.frontier_cells)
        return tuple(centers[first:last] for first, last in self.spans.tolist())

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.costs)


@njit(cache=True, error_model="numpy")
def _count_near(points, x, y, radius):
    """Count the points, shape (n, 2), within `radius` of (x, y)."""
    count = 0
    for k in range(len(points)):
        count += math.hypot(points[k, 0] - x, points[k, 1] - y) <= radius
    return count


@njit(cache=True, error_model="numpy")
def _since(seen, x, y, radius, now):
    """Return since when there has been a candidate near (x, y) [s]; seen: shape (n, 3), float64, x, y, since when."""
    since = now
    for k in range(len(seen)):
        if math.hypot(seen[k, 0] - x, seen[k, 1] - y) <= radius:
            since = min(since, seen[k, 2])
    return since


@njit(cache=True, error_model="numpy")
def _nearest_within(points, x, y, radius):
    """Return which of points (rows (x, y, ...)) is nearest to (x, y), -1 if none is within `radius`."""
    nearest, best = -1, radius
    for k in range(len(points)):
        gap = math.hypot(points[k, 0] - x, points[k, 1] - y)
        if gap <= best and (nearest < 0 or gap < best):
            nearest, best = k, gap
    return nearest


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
def describe(raster, found, tables, frame, theta, now, past):
    """Describe candidates in metres and seconds.

    Args:
        raster: occupancy, shape (height, width), int8, and predecessors, shape (height + 2, width + 2), uint8, of the
            search that found them.
        found: shape (k,), `FOUND`.
        tables: `PlanningTables`.
        frame: where the first column and the first row begin, map frame [m], and the side of a cell [m].
        theta: heading of the robot [rad].
        now: time [s].
        past: frontiers of the candidates before (x, y), and since when they have been there, shape (n, 3); frontiers
            that the robot did not get to, shape (m, 2); the frontier that was chosen last (x, y), NaN for none; and the
            distance up to which two frontiers are the same; map frame [m, s].

    Returns:
        Shape (k,), `CANDIDATE`; shape (k, 3), float64, the frontiers for the next call; and the index of the candidate
        that was chosen last, -1 if it is gone.
    """
    joined, predecessor = raster
    left, low, side = frame
    before, failures, chosen, radius = past
    table, seen = np.empty(len(found), dtype=CANDIDATE), np.empty((len(found), 3))
    reach, directions = tables.view_reach, ray_directions()
    free, unknown = np.empty(NUM_RAYS), np.empty(NUM_RAYS)
    for k in range(len(found)):
        cell, out = found[k], table[k]
        goal_row, goal_col = cell.goal
        row, col = cell.frontier
        out.viewpoint[0], out.viewpoint[1] = left + (goal_col + 0.5) * side, low + (goal_row + 0.5) * side
        x, y = left + (col + 0.5) * side, low + (row + 0.5) * side
        out.frontier[0], out.frontier[1] = x, y
        seen[k, 0], seen[k, 1], seen[k, 2] = x, y, _since(before, x, y, radius, now)
        out.cost, out.size = cell.cost * side / (STRAIGHT * SCALE), cell.size * side
        for i in range(len(SHARE_RADII)):
            out.unknown[i] = unknown_share(joined, row, col, SHARE_RADII[i] / side)
        outward = cast_view(joined, goal_row, goal_col, reach, directions, free, unknown)
        out.visible = unknown.sum() * side * side
        fill_sectors(free, unknown, outward, reach, out.sectors)
        out.clearance = min(_clearance(joined, goal_row, goal_col, tables.inflation) / tables.inflation, 1.0)
        path = walk_back(predecessor, goal_row, goal_col)
        # On the viewpoint already, the path on is the one to what is to be seen.
        if path.shape[0] > 1:
            ahead = min(tables.heading_steps, path.shape[0] - 1)
            row, col = path[ahead, 0], path[ahead, 1]
        out.turn = wrap_angle(math.atan2(row - path[0, 0], col - path[0, 1]) - theta)
        out.age = now - seen[k, 2]
        out.failures = _count_near(failures, x, y, radius)
    return table, seen, _nearest_within(seen, chosen[0], chosen[1], radius)


@njit(cache=True, error_model="numpy")
def fill_features(table, chosen, x, y, theta, max_failures, features, sectors, gaps):
    """Write what policies see of candidates; see `ExploreFrontiersEnv`. Rows without a candidate are 0.

    Args:
        table: shape (k,), `CANDIDATE`.
        chosen: index of the candidate that the last drive was for; -1 for none.
        x: estimated position, map frame [m].
        y: estimated position, map frame [m].
        theta: estimated heading [rad].
        max_failures: number of failures that counts as one.
        features: shape (n, NUM_FEATURES), float32, n >= k, written.
        sectors: shape (n, 2 * NUM_SECTORS), float32, written.
        gaps: shape (n, n), float32, written.
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
        out[SIZE] = row.size / (row.size + HALF_SIZE)
        out[CLEARANCE] = row.clearance
        out[AGE] = row.age / (row.age + HALF_AGE)
        out[AHEAD] = min(max((c * dx + s * dy) / REACH, -1.0), 1.0)
        out[LEFT] = min(max((c * dy - s * dx) / REACH, -1.0), 1.0)
        out[FAILURES] = min(row.failures / max_failures, 1.0)
        sectors[k] = row.sectors
        for i in range(k):
            gap = math.hypot(row.frontier[0] - table[i].frontier[0], row.frontier[1] - table[i].frontier[1])
            gaps[k, i] = gaps[i, k] = gap / (gap + HALF_COST)
    if chosen >= 0:
        features[chosen, CHOSEN] = 1.0
