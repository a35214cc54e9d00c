"""What a policy is told of each candidate."""

import math

import numpy as np
from numba import njit

from envs.frontier_choice.candidates import (
    CLEARANCE,
    COST,
    FRONTIER_COL,
    FRONTIER_ROW,
    GAIN,
    GOAL_COL,
    GOAL_ROW,
    HEADING,
    SIZE,
)
from envs.geometry.pose import wrap_angle
from envs.navigation.astar import SCALE, STRAIGHT

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


@njit(cache=True, error_model="numpy")
def _count_near(points, x, y, radius):
    """Count the points, shape (n, 2), within `radius` of (x, y)."""
    count = 0
    for k in range(len(points)):
        count += math.hypot(points[k, 0] - x, points[k, 1] - y) <= radius
    return count


@njit(cache=True, error_model="numpy")
def _nearest(points, point, radius):
    """Return which of points (columns 0 and 1) is nearest to `point` (x, y), -1 if none is within `radius`."""
    nearest, best = -1, radius
    for k in range(len(points)):
        gap = math.hypot(points[k, 0] - point[0], points[k, 1] - point[1])
        if gap <= best and (nearest < 0 or gap < best):
            nearest, best = k, gap
    return nearest


@njit(cache=True, error_model="numpy")
def _since(places, x, y, radius, now):
    """Return since when there has been a candidate near (x, y) [s]; places: shape (n, 3), float64, x, y, since when."""
    since = now
    for k in range(len(places)):
        if math.hypot(places[k, 0] - x, places[k, 1] - y) <= radius:
            since = min(since, places[k, 2])
    return since


@njit(cache=True, error_model="numpy", nogil=True)
def describe(
    found, top, left, origin_x, origin_y, side, pose, now, before, failures, chosen, retry_radius, scales, features
):
    """Turn candidates into places in the map frame and into features.

    Args:
        found: shape (k, 9), float64, see `CANDIDATE_FIELDS`.
        top: first row [planning cells].
        left: first column.
        origin_x: position of the map's corner, map frame [m].
        origin_y: the same [m].
        side: of a planning cell [m].
        pose: believed pose of the robot (x, y, theta), map frame.
        now: time [s].
        before: shape (n, 3), float64: frontiers of the candidates before (x, y), and since when they have been there.
        failures: shape (m, 2), float64: frontiers that the robot did not get to, map frame [m].
        chosen: frontier (x, y) that was driven to last, map frame [m].
        retry_radius: candidates this near to each other are the same [m].
        scales: what counts as one: gain [cells], clearance [cells], failures.
        features: shape (max_candidates, 10), float32, written.

    Returns:
        Shape (k, 4), float64: where to stand (x, y) and what to see from there, map frame [m]; and shape (k, 3), the
        next `before`.
    """
    num_found = len(found)
    places, seen = np.empty((num_found, 4)), np.empty((num_found, 3))
    x, y, theta = pose
    c, s = math.cos(theta), math.sin(theta)
    features[:] = 0.0
    for k in range(num_found):
        row = found[k]
        places[k, 0] = origin_x + (left + row[GOAL_COL] + 0.5) * side
        places[k, 1] = origin_y + (top + row[GOAL_ROW] + 0.5) * side
        places[k, 2] = origin_x + (left + row[FRONTIER_COL] + 0.5) * side
        places[k, 3] = origin_y + (top + row[FRONTIER_ROW] + 0.5) * side
        there_x, there_y = places[k, 2], places[k, 3]
        seen[k, 0], seen[k, 1] = there_x, there_y
        seen[k, 2] = _since(before, there_x, there_y, retry_radius, now)
        cost, size = row[COST] * side / (STRAIGHT * SCALE), row[SIZE] * side
        age = now - seen[k, 2]
        dx, dy = there_x - x, there_y - y
        features[k, 0] = min(row[GAIN] / scales[0], 1.0)
        features[k, 1] = cost / (cost + HALF_COST)
        features[k, 2] = wrap_angle(row[HEADING] - theta) / math.pi
        features[k, 3] = size / (size + HALF_SIZE)
        features[k, 4] = min(row[CLEARANCE] / scales[1], 1.0)
        features[k, 5] = age / (age + HALF_AGE)
        features[k, 6] = min(max((c * dx + s * dy) / REACH, -1.0), 1.0)
        features[k, 7] = min(max((c * dy - s * dx) / REACH, -1.0), 1.0)
        features[k, 8] = min(_count_near(failures, there_x, there_y, retry_radius) / scales[2], 1.0)
    k = _nearest(seen, chosen, retry_radius)
    if k >= 0:
        features[k, CHOSEN] = 1.0
    return places, seen
