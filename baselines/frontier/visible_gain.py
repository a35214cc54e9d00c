"""How much unknown area a lidar could see from a viewpoint, if that area were free."""

import math

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid
from envs.geometry.lines import cell_along

OCCUPIED_FROM = 50
"""Occupancy from which a cell stops a ray [percent]."""


@njit(cache=True, error_model="numpy")
def _count_visible(data, row, col, reach, seen):
    """Count the unknown cells that straight lines from the centre of a cell meet before anything occupied.

    The rays end one cell apart on a circle, and are sampled once per cell.

    Args:
        data: shape (height, width), int8, occupancy.
        row: row of the viewpoint.
        col: column of the viewpoint.
        reach: length of the rays [cells].
        seen: shape (height, width), bool, all false before and after.
    """
    height, width = data.shape
    num_rays = math.ceil(2.0 * math.pi * reach)
    count = 0
    top, bottom = max(row - reach, 0), min(row + reach + 1, height)
    left, right = max(col - reach, 0), min(col + reach + 1, width)
    for k in range(num_rays):
        angle = 2.0 * math.pi * k / num_rays
        d_row, d_col = math.sin(angle), math.cos(angle)
        for step in range(1, reach + 1):
            r, c = cell_along(row, col, d_row, d_col, step)
            if r < 0 or c < 0 or r >= height or c >= width or data[r, c] >= OCCUPIED_FROM:
                break
            if data[r, c] < 0 and not seen[r, c]:
                seen[r, c] = True
                count += 1
    seen[top:bottom, left:right] = False
    return count


@njit(cache=True, error_model="numpy")
def _gains(data, cells, reach):
    counts = np.empty(cells.shape[0], dtype=np.int64)
    window = np.full((2 * reach + 1, 2 * reach + 1), -1, dtype=np.int8)
    seen = np.zeros(window.shape, dtype=np.bool_)
    height, width = data.shape
    for k in range(cells.shape[0]):
        row, col = cells[k]
        window[:] = -1
        for r in range(max(row - reach, 0), min(row + reach + 1, height)):
            for c in range(max(col - reach, 0), min(col + reach + 1, width)):
                window[r - row + reach, c - col + reach] = data[r, c]
        counts[k] = _count_visible(window, reach, reach, reach, seen)
    return counts


def visible_gains(grid: OccupancyGrid, points: np.ndarray, max_range: float) -> np.ndarray:
    """Tell how much unknown area lies in view of points: behind nothing occupied, the unknown itself taken for free.

    Args:
        grid: the map. What lies beyond its edge is unknown, too.
        points: shape (n, 2), float64, (x, y) [m].
        max_range: how far is looked [m].

    Returns:
        Shape (n,), float64 [m2].
    """
    gains: np.ndarray = _gains(grid.data, grid.cells(points), round(max_range / grid.resolution))
    return gains * grid.resolution**2
