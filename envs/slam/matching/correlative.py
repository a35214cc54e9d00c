"""Correlative scan matching: trying all poses of a window (Olson, Real-time correlative scan matching, 2009)."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

MAX_HITS = 90
"""Hits of a scan that are looked up, evenly chosen."""
TURN_STEP = 0.02
"""From one heading to the next [rad]."""
PENALTY = 0.01
"""Taken off the score for each squared standard deviation from the predicted pose."""


class SearchWindow(NamedTuple):
    """Poses that are tried, around the predicted one. Lengths in cells of the finest map."""

    distance: float
    """Farthest along each axis [cells]."""
    angle: float
    """Farthest turn [rad]."""
    position_std: float
    """Standard deviation of the predicted position [cells]."""
    heading_std: float
    """Standard deviation of the predicted heading [rad]."""


@njit(cache=True, error_model="numpy")
def search_window(occupancy, scale, points, num_points, pose, window):
    """Return the best of the poses around a predicted one, whole cells and steps of `TURN_STEP` apart.

    The score of a pose is the mean occupancy of the cells that the hits fall in, less `PENALTY`.

    Args:
        occupancy: shape (height, width), int8, percent; -1 unknown, which counts as one half.
        scale: side of a cell of the finest map in cells of this one.
        points: shape (2, >= num_points), float32, hits in the base frame [cells of the finest map].
        num_points: number of hits, at least 1.
        pose: predicted x, y from the map's corner [cells of the finest map] and heading [rad].
        window: `SearchWindow`.

    Returns:
        The pose (x, y, theta), in the units of `pose`.
    """
    height, width = occupancy.shape
    flat = occupancy.ravel()
    stride = (num_points + MAX_HITS - 1) // MAX_HITS
    count = (num_points + stride - 1) // stride
    rows, cols = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    reach, num_turns = math.ceil(window.distance * scale), math.ceil(window.angle / TURN_STEP)
    per_cell = PENALTY / (window.position_std * scale) ** 2
    per_turn = PENALTY * (TURN_STEP / window.heading_std) ** 2
    best, best_pose = -np.inf, pose
    for turn in range(-num_turns, num_turns + 1):
        theta = pose[2] + turn * TURN_STEP
        c, s = math.cos(theta), math.sin(theta)
        for k in range(count):
            p_x, p_y = float(points[0, k * stride]), float(points[1, k * stride])
            cols[k] = math.floor((c * p_x - s * p_y + pose[0]) * scale)
            rows[k] = math.floor((s * p_x + c * p_y + pose[1]) * scale)
        for up in range(-reach, reach + 1):
            for right in range(-reach, reach + 1):
                total = 0
                for k in range(count):
                    row, col = rows[k] + up, cols[k] + right
                    is_inside = (row >= 0) & (col >= 0) & (row < height) & (col < width)
                    value = int(flat[np.uint64(row * width + col if is_inside else 0)]) if is_inside else -1
                    total += value if value >= 0 else 50
                penalty = per_cell * (up * up + right * right) + per_turn * turn * turn
                score = 0.01 * total / count - penalty
                if score > best:
                    best, best_pose = score, (pose[0] + right / scale, pose[1] + up / scale, theta)
    return best_pose
