"""Frontiers: where what is known to be free borders on what is unknown (Yamauchi, 1997)."""

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid

FREE_BELOW = 50
"""Occupancy from which a cell no longer counts as free [percent]."""


@njit(cache=True, error_model="numpy")
def mark_frontier(data):
    """Mark free cells (0..49) with an unknown cell (-1) among their eight neighbours.

    Works on whole rows, so that the compiler vectorises it: the least value in the three rows around a cell, then the
    least of three neighbouring columns, is negative exactly where one of the nine cells is unknown.
    """
    height, width = data.shape
    mask = np.zeros((height, width), dtype=np.bool_)
    lowest = np.empty(width, dtype=np.int8)
    for row in range(height):
        above, middle, below = data[max(row - 1, 0)], data[row], data[min(row + 1, height - 1)]
        for col in range(width):
            lowest[col] = min(above[col], middle[col], below[col])
        for col in range(1, width - 1):
            near = min(lowest[col - 1], lowest[col], lowest[col + 1])
            mask[row, col] = (middle[col] >= 0) & (middle[col] < FREE_BELOW) & (near < 0)
        for col in (0, width - 1):
            near = min(lowest[max(col - 1, 0)], lowest[col], lowest[min(col + 1, width - 1)])
            mask[row, col] = (middle[col] >= 0) & (middle[col] < FREE_BELOW) & (near < 0)
    return mask


def frontier_mask(grid: OccupancyGrid) -> np.ndarray:
    """Mark the frontier cells of a map: free ones with an unknown one among their eight neighbours.

    Returns:
        Shape of the map, bool.
    """
    return mark_frontier(grid.data)


@njit(cache=True, error_model="numpy")
def count_unknown(data, row, col, radius):
    """Count the unknown cells (-1) within a disc; what lies outside the array has not been observed either.

    Args:
        data: shape (height, width), int8, occupancy.
        row: row of the centre.
        col: column of the centre.
        radius: radius of the disc [cells].
    """
    height, width = data.shape
    count = 0
    reach = int(radius)
    for d_row in range(-reach, reach + 1):
        r = row + d_row
        half = int(np.sqrt(radius * radius - d_row * d_row))
        if r < 0 or r >= height:
            count += 2 * half + 1
            continue
        for c in range(col - half, col + half + 1):
            count += c < 0 or c >= width or data[r, c] < 0
    return count
