"""Correlative scan matching by exhaustive search (Olson, Real-time correlative scan matching, 2009)."""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.lookup import load

MAX_HITS = 60
"""Maximum number of scan points scored per pose, evenly chosen."""
TURN_STEP = 0.03
WINDOW_STDS, PENALTY = 2.0, 0.01
"""Maximum deviation from the predicted pose, and score penalty per squared deviation, in standard deviations."""


@njit(cache=True, error_model="numpy")
def _total_inside(flat, indices, shift, unknown):
    total = 0
    for k in range(indices.shape[0]):
        value = int(load(flat, np.uint64(indices[k] + shift)))
        total += value if value >= 0 else unknown
    return total


@njit(cache=True, error_model="numpy")
def _total(occupancy, cells, up, right, unknown):
    height, width = occupancy.shape
    total = 0
    for k in range(cells.shape[1]):
        row, col = cells[0, k] + up, cells[1, k] + right
        value = -1
        if row >= 0 and col >= 0 and row < height and col < width:
            value = int(occupancy[row, col])
        total += value if value >= 0 else unknown
    return total


@njit(cache=True, error_model="numpy")
def search_window(occupancy, scale, points, num_points, pose, stds, unknown):
    """Return the pose near a prediction with the highest mean occupancy at the scan points, minus a prior penalty.

    `occupancy`: map, shape (height, width), int8 [percent]. `scale`: cell side of the finest map divided by that of
    `occupancy`. Other arguments are in cells of the finest map. `points`: scan points, base frame. `pose`: predicted x,
    y from the map's corner and heading [rad], like the result. `stds`: standard deviations of its position and heading,
    0 for a known heading. `unknown`: occupancy of unknown cells [percent].
    """
    height, width = occupancy.shape
    flat = occupancy.ravel()
    stride = (num_points + MAX_HITS - 1) // MAX_HITS
    count = (num_points + stride - 1) // stride
    position_std, heading_std = stds
    reach, num_turns = math.ceil(WINDOW_STDS * position_std * scale), math.ceil(WINDOW_STDS * heading_std / TURN_STEP)
    per_cell = PENALTY / (position_std * scale) ** 2
    per_turn = PENALTY * (TURN_STEP / heading_std) ** 2 if heading_std > 0.0 else 0.0
    cells, indices = np.empty((2, count), dtype=np.int64), np.empty(count, dtype=np.int64)
    best, best_pose = -np.inf, pose
    for turn in range(-num_turns, num_turns + 1):
        theta = pose[2] + turn * TURN_STEP
        c, s = math.cos(theta), math.sin(theta)
        lowest, highest = min(height, width), -1
        for k in range(count):
            p_x, p_y = float(points[0, k * stride]), float(points[1, k * stride])
            col = math.floor((c * p_x - s * p_y + pose[0]) * scale)
            row = math.floor((s * p_x + c * p_y + pose[1]) * scale)
            cells[0, k], cells[1, k], indices[k] = row, col, row * width + col
            lowest, highest = min(lowest, row, col), max(highest, row - height, col - width)
        is_inside = lowest >= reach and highest + reach < 0
        for up in range(-reach, reach + 1):
            for right in range(-reach, reach + 1):
                if is_inside:
                    total = _total_inside(flat, indices, up * width + right, unknown)
                else:
                    total = _total(occupancy, cells, up, right, unknown)
                penalty = per_cell * (up * up + right * right) + per_turn * turn * turn
                score = 0.01 * total / count - penalty
                if score > best:
                    best, best_pose = score, (pose[0] + right / scale, pose[1] + up / scale, theta)
    return best_pose
