"""Whether a scan agrees with a map: what tells that a robot is lost."""

import math

import numpy as np
from numba import njit

LEAST_HITS = 40
"""Hits on known cells from which on `fits_map` judges a scan."""
LEAST_MAP_SHARE, LEAST_SUBMAP_SHARE = 0.6, 0.68
"""Share of these hits that must lie at occupied cells of the map of a drive, which may bend, and of a submap."""


@njit(cache=True, error_model="numpy")
def count_hits(occupancy, points, num_points, x, y, theta):
    """Count the hits of a scan on or next to occupied cells, and those on free cells with no occupied one next to them.

    A wall that is off by a cell agrees with the map, other than by the mean occupancy under the hits.

    Args:
        occupancy: shape (height, width), int8 [percent]: -1 unknown.
        points: shape (2, >= num_points), float32, hits in the base frame [cells].
        num_points: number of hits.
        x: position from the map's corner [cells].
        y: position from the map's corner [cells].
        theta: heading [rad].
    """
    height, width = occupancy.shape
    c, s = math.cos(theta), math.sin(theta)
    num_occupied = num_free = 0
    for k in range(num_points):
        p_x, p_y = float(points[0, k]), float(points[1, k])
        u, v = c * p_x - s * p_y + x, s * p_x + c * p_y + y
        if not (u >= 1.0 and v >= 1.0 and u < width - 1 and v < height - 1):
            continue
        row, col = int(v), int(u)
        greatest = np.int8(-1)
        for i in range(row - 1, row + 2):
            for j in range(col - 1, col + 2):
                greatest = max(greatest, occupancy[i, j])
        if greatest > 50:
            num_occupied += 1
        elif occupancy[row, col] >= 0:
            num_free += 1
    return num_occupied, num_free


def fits_map(
    occupancy: np.ndarray, points: np.ndarray, num_points: int, pose: tuple[float, float, float], least_share: float
) -> bool | None:
    """Tell whether at least a share of the hits on known cells lies at occupied ones; None with too few of them.

    Arguments are those of `count_hits`; `pose` is (x, y, theta) [cells, cells, rad].
    """
    num_occupied, num_free = count_hits(occupancy, points, num_points, *pose)
    if num_occupied + num_free < LEAST_HITS:
        return None
    return bool(num_occupied >= least_share * (num_occupied + num_free))
