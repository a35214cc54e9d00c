"""Features of each candidate, for rules and policies. Kernels, and the record that rules get."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from envs.geometry import Pose2D
from envs.geometry.pose import wrap_angle
from envs.navigation.astar import SCALE, STRAIGHT
from envs.navigation.candidates import COST, FRONTIER_COL, FRONTIER_ROW, GOAL_COL, GOAL_ROW, SIZE
from envs.navigation.costmap import Costmap

FEATURES = ("gain", "cost", "turn", "size", "clearance", "age", "ahead", "left", "failures", "chosen")
"""Columns of the observation's candidates; see `ExploreFrontiersEnv`."""
CHOSEN = FEATURES.index("chosen")
HALF_COST = 5.0
"""Travel cost that counts as one half [m]."""
HALF_SIZE = 2.0
"""Length of a frontier that counts as one half [m]."""
HALF_AGE = 60.0
"""Age of a frontier that counts as one half [s]."""
REACH = 16.0
"""Distance of a candidate that counts as one [m]."""


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
    gains: np.ndarray
    """Shape (k,), float64: share of the area within 1 m of the frontier that is unknown."""
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
    cells: tuple[np.ndarray, ...]
    """For each candidate shape (n, 2), float64: centres of all its frontier cells (x, y) [m]."""
    costmap: Costmap
    """Costs on planning cells; its array is live."""

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
def nearest_within(points, x, y, radius):
    """Return which of points (shape (n, 2)) is nearest to (x, y), -1 if none is within `radius`."""
    nearest, best = -1, radius
    for k in range(len(points)):
        gap = math.hypot(points[k, 0] - x, points[k, 1] - y)
        if gap <= best and (nearest < 0 or gap < best):
            nearest, best = k, gap
    return nearest


TABLE_COLUMNS = 11
VIEW_X, VIEW_Y, THERE_X, THERE_Y, LENGTH, EXTENT, GAIN, CLEARANCE, TURN, AGE, FAILURES = range(TABLE_COLUMNS)


@njit(cache=True, error_model="numpy")
def make_table(found, described, frame, theta, now, before, failures, radius):
    """Turn candidates into metres and seconds.

    Args:
        found: shape (k, 7), float64, see `CANDIDATE_FIELDS`.
        described: shape (k, 3), float64, see `describe_surroundings`.
        frame: position of the raster's corner (x, y) in the map frame [m], side of its cells [m], number of cells that
            count as a gain of one, clearance that counts as one [cells].
        theta: heading of the robot [rad].
        now: time [s].
        before: shape (n, 3), float64: frontiers of the candidates before (x, y), and since when they have been there.
        failures: shape (m, 2), float64: frontiers that the robot did not get to, map frame [m].
        radius: candidates this near to each other are the same [m].

    Returns:
        Shape (k, 11), float64: columns `VIEW_X` to `FAILURES`; and shape (k, 3), float64, the next `before`.
    """
    x0, y0, side, full_gain, full_clearance = frame
    table, seen = np.empty((len(found), TABLE_COLUMNS)), np.empty((len(found), 3))
    for k in range(len(found)):
        row, out = found[k], table[k]
        out[VIEW_X], out[VIEW_Y] = x0 + (row[GOAL_COL] + 0.5) * side, y0 + (row[GOAL_ROW] + 0.5) * side
        out[THERE_X], out[THERE_Y] = x0 + (row[FRONTIER_COL] + 0.5) * side, y0 + (row[FRONTIER_ROW] + 0.5) * side
        seen[k, 0], seen[k, 1] = out[THERE_X], out[THERE_Y]
        seen[k, 2] = _since(before, out[THERE_X], out[THERE_Y], radius, now)
        out[LENGTH], out[EXTENT] = row[COST] * side / (STRAIGHT * SCALE), row[SIZE] * side
        out[GAIN] = min(described[k, 0] / full_gain, 1.0)
        out[CLEARANCE] = min(described[k, 1] / full_clearance, 1.0)
        out[TURN] = wrap_angle(described[k, 2] - theta)
        out[AGE] = now - seen[k, 2]
        out[FAILURES] = _count_near(failures, out[THERE_X], out[THERE_Y], radius)
    return table, seen


@njit(cache=True, error_model="numpy")
def _fill(table, chosen, x, y, theta, max_failures, features):
    c, s = math.cos(theta), math.sin(theta)
    features[:] = 0.0
    for k in range(len(table)):
        row = table[k]
        dx, dy = row[THERE_X] - x, row[THERE_Y] - y
        features[k, 0] = row[GAIN]
        features[k, 1] = row[LENGTH] / (row[LENGTH] + HALF_COST)
        features[k, 2] = row[TURN] / math.pi
        features[k, 3] = row[EXTENT] / (row[EXTENT] + HALF_SIZE)
        features[k, 4] = row[CLEARANCE]
        features[k, 5] = row[AGE] / (row[AGE] + HALF_AGE)
        features[k, 6] = min(max((c * dx + s * dy) / REACH, -1.0), 1.0)
        features[k, 7] = min(max((c * dy - s * dx) / REACH, -1.0), 1.0)
        features[k, 8] = min(row[FAILURES] / max_failures, 1.0)
    if chosen >= 0:
        features[chosen, CHOSEN] = 1.0


def fill_features(table: np.ndarray, chosen: int, pose: Pose2D, max_failures: int, features: np.ndarray) -> None:
    """Write the features of candidates as policies see them.

    Args:
        table: shape (k, 11), float64, see `make_table`.
        chosen: index of the candidate that the last drive was for; -1 for none.
        pose: estimate now, map frame.
        max_failures: number of failures that counts as one.
        features: shape (n, 10), float32, n >= k, written: see `ExploreFrontiersEnv`; 0 in rows without a candidate.
    """
    _fill(table, chosen, *pose, max_failures, features)
