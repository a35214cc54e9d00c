"""Lookup of static obstacles near people."""

import math
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit

WALL_RANGE = 0.4
"""Maximum gap between a person and an obstacle that affects the person [m]."""
CELL = 0.25
"""Cell size of the obstacle lookup grid [m]."""
_MAX_PUSHES = 12
_TOLERANCE = 1e-6


class Walls(NamedTuple):
    """Lookup table of the static obstacles near each grid cell."""

    near: np.ndarray
    """Table of the obstacles near each grid cell, packed into one array, shape (k,), float64.

    Contains for each cell the start of its list, the lists of obstacle indices, and per obstacle five numbers (x0, y0,
    x1, y1, radius) [m]."""
    grid: tuple[float, float, float, float]
    """Origin (x, y) of the grid [m], and number of rows and columns."""


def list_walls(
    segments: np.ndarray, circles: np.ndarray, bounds: tuple[float, float, float, float], radius: float
) -> Walls:
    """Return a lookup table of the obstacles near each cell of a grid.

    `segments`, `circles`: obstacles, shapes (n, 4) and (m, 3), float64 [m]. `bounds`: grid area (x_min, y_min, x_max,
    y_max) [m]. `radius`: radius of the largest person [m].
    """
    x_min, y_min, x_max, y_max = map(float, bounds)
    rows, cols = math.ceil((y_max - y_min) / CELL) + 1, math.ceil((x_max - x_min) / CELL) + 1
    bodies = np.vstack([np.column_stack([segments, np.zeros(len(segments))]), circles[:, [0, 1, 0, 1, 2]]])
    cells, items = _pairs(bodies, bodies.ravel(), radius + WALL_RANGE, x_min, y_min, rows, cols)
    order, first = np.argsort(cells, kind="stable"), rows * cols + 1
    starts = first + np.searchsorted(cells[order], np.arange(first))
    near = np.concatenate([starts, first + len(items) + items[order], bodies.ravel()])
    return Walls(near, (x_min, y_min, float(rows), float(cols)))


@njit(cache=True, error_model="numpy", inline="always")
def offset(near, item, x, y):
    """Return the unit vector from the nearest point of an obstacle to the point (x, y), and the distance [m]."""
    ex, ey = near[item + 2] - near[item], near[item + 3] - near[item + 1]
    dx, dy = x - near[item], y - near[item + 1]
    along = min(max((dx * ex + dy * ey) / max(ex * ex + ey * ey, 1e-300), 0.0), 1.0)
    dx, dy = dx - along * ex, dy - along * ey
    distance = math.sqrt(dx * dx + dy * dy)
    scale = 1.0 / max(distance, 1e-300)
    return dx * scale, dy * scale, distance - near[item + 4]


@njit(cache=True, error_model="numpy")
def _pairs(bodies, near, reach, origin_x, origin_y, rows, cols):
    reach += math.sqrt(0.5) * CELL
    cells, items = [0 for _ in range(0)], [0 for _ in range(0)]
    for k in range(bodies.shape[0]):
        x0, y0, x1, y1, radius = bodies[k]
        left, right = min(x0, x1) - radius - reach - origin_x, max(x0, x1) + radius + reach - origin_x
        low, high = min(y0, y1) - radius - reach - origin_y, max(y0, y1) + radius + reach - origin_y
        for row in range(max(math.floor(low / CELL), 0), min(math.floor(high / CELL) + 1, rows)):
            for col in range(max(math.floor(left / CELL), 0), min(math.floor(right / CELL) + 1, cols)):
                x, y = origin_x + (col + 0.5) * CELL, origin_y + (row + 0.5) * CELL
                if offset(near, 5 * k, x, y)[2] <= reach:
                    cells.append(row * cols + col)
                    items.append(5 * k)
    return np.array(cells), np.array(items)


@njit(cache=True, error_model="numpy", inline="always")
def near_list(near, grid, x, y):
    """Return the index range (first, end) of the obstacles near (x, y) in a list of obstacles per grid cell."""
    row, col = math.floor((y - grid[1]) / CELL), math.floor((x - grid[0]) / CELL)
    if not (0 <= row < grid[2] and 0 <= col < grid[3]):
        return 0, 0
    cell = int(row * grid[3] + col)
    return int(near[cell]), int(near[cell + 1])


@njit(cache=True, error_model="numpy", inline="always")
def clearance(near, grid, x, y):
    """Return the distance from the point (x, y) to the nearest static obstacle [m], or inf without obstacles nearby."""
    first, end = near_list(near, grid, x, y)
    nearest = np.inf
    for k in range(first, end):
        nearest = min(nearest, offset(near, int(near[k]), x, y)[2])
    return nearest


@njit(cache=True, error_model="numpy", inline="always")
def push_out(near, grid, x, y, radius):
    """Push a disc out of overlapping obstacles. Return its centre (x, y) [m], and True if no overlap remains."""
    for _ in range(_MAX_PUSHES):
        first, end = near_list(near, grid, x, y)
        deepest, push_x, push_y = _TOLERANCE, 0.0, 0.0
        for k in range(first, end):
            nx, ny, gap = offset(near, int(near[k]), x, y)
            if radius - gap > deepest:
                deepest, push_x, push_y = radius - gap, nx, ny
        if deepest == _TOLERANCE:
            return x, y, True
        x, y = x + deepest * push_x, y + deepest * push_y
    return x, y, False
