"""How much unknown area a lidar could see from a viewpoint, if that area were free."""

import math

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid
from envs.geometry.lines import cell_along

OCCUPIED_FROM = 50
"""Occupancy from which a cell stops a ray [percent]."""


@njit(cache=True, error_model="numpy")
def _count_visible(data, cells, reach):
    """Count the unknown cells that straight lines from the centres of cells meet before anything occupied.

    The rays end one cell apart on a circle, and are sampled once per cell. Around each cell they are followed in a
    window of their own, in which what lies beyond the edge of the map is unknown.

    Args:
        data: shape (height, width), int8, occupancy.
        cells: shape (n, 2), int64, (row, column) of the viewpoints.
        reach: length of the rays [cells].

    Returns:
        Shape (n,), int64.
    """
    counts = np.zeros(len(cells), dtype=np.int64)
    window = np.empty((2 * reach + 1, 2 * reach + 1), dtype=np.int8)
    num_rays = math.ceil(2.0 * math.pi * reach)
    for n in range(len(cells)):
        row, col = cells[n]
        window[:] = -1
        for r in range(max(row - reach, 0), min(row + reach + 1, data.shape[0])):
            for c in range(max(col - reach, 0), min(col + reach + 1, data.shape[1])):
                window[r - row + reach, c - col + reach] = data[r, c]
        for k in range(num_rays):
            angle = 2.0 * math.pi * k / num_rays
            d_row, d_col = math.sin(angle), math.cos(angle)
            for step in range(1, reach + 1):
                r, c = cell_along(reach, reach, d_row, d_col, step)
                if window[r, c] >= OCCUPIED_FROM:
                    break
                if window[r, c] < 0:
                    window[r, c] = 0  # counted once
                    counts[n] += 1
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
    counts: np.ndarray = _count_visible(grid.data, grid.cells(points), round(max_range / grid.resolution))
    return counts * grid.resolution**2
