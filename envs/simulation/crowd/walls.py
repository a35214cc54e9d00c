"""Static obstacles around people: which are near, how far they are, and what keeps people out of them."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

REACH = 0.4
"""Obstacles farther than this from a person's body are not looked at [m]."""
CELL = 0.25
"""Side of the cells that list the obstacles near them [m]."""
_MAX_PUSHES = 12
"""How often a disc is pushed out of what it overlaps; then it is wedged."""
_TOLERANCE = 1e-6
"""Overlap that does not count [m]."""


class Walls(NamedTuple):
    """Static obstacles of a world, listed by the cells of a grid that they are near; for kernels.

    These unpack it once: to take an array out of it for each person takes longer than all that is done with it.
    """

    near: np.ndarray
    """Shape (k,), float64: where each cell's list begins in this array and where the last one ends; the lists, which
    hold where obstacles begin in this array; and the obstacles: lines (x0, y0, x1, y1) and their radius [m]."""
    grid: tuple[float, float, float, float]
    """Where the first column and the first row begin [m], and how many rows and columns there are."""


def list_walls(
    segments: np.ndarray, circles: np.ndarray, bounds: tuple[float, float, float, float], radius: float
) -> Walls:
    """List the obstacles within `REACH` of a body of a radius [m] in each cell of a grid.

    `segments`, shape (n, 4), and `circles`, shape (m, 3), are float64 [m]; `bounds`: of the grid, (x_min, y_min, x_max,
    y_max) [m].
    """
    x_min, y_min, x_max, y_max = bounds
    rows, cols = math.ceil((y_max - y_min) / CELL) + 1, math.ceil((x_max - x_min) / CELL) + 1
    bodies = np.vstack([np.column_stack([segments, np.zeros(len(segments))]), circles[:, [0, 1, 0, 1, 2]]])
    cells, items = _pairs(bodies, bodies.ravel(), radius + REACH, x_min, y_min, rows, cols)
    order, first = np.argsort(cells, kind="stable"), rows * cols + 1
    starts = first + np.searchsorted(cells[order], np.arange(first))
    near = np.concatenate([starts, first + len(items) + items[order], bodies.ravel()])
    return Walls(near, (x_min, y_min, float(rows), float(cols)))


@njit(cache=True, error_model="numpy", inline="always")
def offset(near, item, x, y):
    """Return the unit vector from the nearest point of an obstacle to (x, y), and the distance [m]."""
    ex, ey = near[item + 2] - near[item], near[item + 3] - near[item + 1]
    dx, dy = x - near[item], y - near[item + 1]
    along = min(max((dx * ex + dy * ey) / max(ex * ex + ey * ey, 1e-300), 0.0), 1.0)
    dx, dy = dx - along * ex, dy - along * ey
    distance = math.sqrt(dx * dx + dy * dy)
    scale = 1.0 / max(distance, 1e-300)
    return dx * scale, dy * scale, distance - near[item + 4]


@njit(cache=True, error_model="numpy")
def _pairs(bodies, near, reach, origin_x, origin_y, rows, cols):
    """Return the indices of cells, and for each where an obstacle that is near it begins in `near`: shapes (n,)."""
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
    """Return where the list of what is near (x, y) begins and ends in `Walls.near`; empty beyond the grid."""
    row, col = math.floor((y - grid[1]) / CELL), math.floor((x - grid[0]) / CELL)
    if not (0 <= row < grid[2] and 0 <= col < grid[3]):
        return 0, 0
    cell = int(row * grid[3] + col)
    return int(near[cell]), int(near[cell + 1])


@njit(cache=True, error_model="numpy", inline="always")
def clearance(near, grid, x, y):
    """Return the distance from (x, y) to the nearest obstacle of `Walls` [m]; inf where none is near."""
    first, end = near_list(near, grid, x, y)
    nearest = np.inf
    for k in range(first, end):
        nearest = min(nearest, offset(near, int(near[k]), x, y)[2])
    return nearest


@njit(cache=True, error_model="numpy", inline="always")
def push_out(near, grid, x, y, radius):
    """Push a disc out of the obstacles of `Walls` that it overlaps, the deepest overlap first.

    Returns its centre (x, y) [m], and whether it is free now; where it is wedged it is not.
    """
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
