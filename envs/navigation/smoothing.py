"""Path smoothing: straight where nothing is lost, round where it bends."""

import math

import numpy as np
from numba import njit

from envs.geometry.polyline import resample

from .costmap import COST_INSCRIBED, COST_UNKNOWN, Costmap

DATA_WEIGHT = 0.2
"""Pull of each point to where it was before (Nav2's `w_data`)."""
SMOOTH_WEIGHT = 0.3
"""Pull of each point to the middle between its neighbours (Nav2's `w_smooth`)."""
NUM_SWEEPS = 100
"""Most sweeps over the path."""
SETTLED = 1e-4
"""A sweep that moves no point by more than this ends the smoothing [m]."""


@njit(cache=True, error_model="numpy")
def relax(points, costs, origin_x, origin_y, resolution, allow_unknown):
    """Return a copy of a path with points pulled between their neighbours and back to where they were.

    A point never moves into a cell that is not traversable; its two ends stay. After the simple smoother of Nav2,
    with the points updated in place (Gauss-Seidel).

    Args:
        points: shape (n, 2), float64 [m].
        costs: shape (height, width), uint8.
        origin_x: x of the outer corner of cell (0, 0) [m].
        origin_y: y of the same [m].
        resolution: side of a cell [m].
        allow_unknown: whether points may move into unknown cells.
    """
    height, width = costs.shape
    smooth = points.copy()
    for _ in range(NUM_SWEEPS):
        largest = 0.0
        for k in range(1, points.shape[0] - 1):
            x, y = smooth[k]
            new_x = x + DATA_WEIGHT * (points[k, 0] - x) + SMOOTH_WEIGHT * (smooth[k - 1, 0] + smooth[k + 1, 0] - 2 * x)
            new_y = y + DATA_WEIGHT * (points[k, 1] - y) + SMOOTH_WEIGHT * (smooth[k - 1, 1] + smooth[k + 1, 1] - 2 * y)
            row, col = math.floor((new_y - origin_y) / resolution), math.floor((new_x - origin_x) / resolution)
            if row < 0 or col < 0 or row >= height or col >= width:
                continue
            cost = costs[row, col]
            if cost >= COST_INSCRIBED and not (cost == COST_UNKNOWN and allow_unknown):
                continue
            smooth[k, 0], smooth[k, 1] = new_x, new_y
            largest = max(largest, abs(new_x - x), abs(new_y - y))
        if largest < SETTLED:
            break
    return smooth


def smooth_path(costmap: Costmap, path: np.ndarray, *, allow_unknown: bool = False) -> np.ndarray:
    """Round off a path's corners without touching anything.

    Args:
        costmap: where the path runs.
        path: shape (n, 2), n > 0, points about a cell apart [m].
        allow_unknown: whether it may enter unknown cells.

    Returns:
        Shape (m, 2), float64, points at most a cell apart, with the same ends [m].
    """
    grid = costmap.grid
    path = np.ascontiguousarray(path, dtype=np.float64)
    smooth: np.ndarray = relax(path, costmap.costs, *grid.origin, grid.resolution, allow_unknown)
    return resample(smooth, grid.resolution)
