"""Static obstacles around people: which are near, how far they are, and what keeps people out of them."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry.clearance import segment_offset

REACH = 0.9
"""Obstacles farther than this from a person's centre are not looked at [m]."""
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

    segments: np.ndarray
    """Shape (n, 4), float64: (x0, y0, x1, y1) [m]."""
    circles: np.ndarray
    """Shape (m, 3), float64: (x, y, radius) [m]."""
    near: np.ndarray
    """Shape (k,), float64: where each cell's list begins in this array, where the last one ends, then the lists:
    indices of segments, and of circles after them."""
    grid: tuple[float, float, float, float]
    """Where the first column and the first row begin [m], and how many rows and columns there are."""


def list_walls(segments: np.ndarray, circles: np.ndarray, bounds: tuple[float, float, float, float]) -> Walls:
    """List the obstacles within `REACH` of every cell of a grid over `bounds`, (x_min, y_min, x_max, y_max) [m].

    `segments`, shape (n, 4), and `circles`, shape (m, 3), are float64 [m].
    """
    x_min, y_min, x_max, y_max = bounds
    rows, cols = math.ceil((y_max - y_min) / CELL) + 1.0, math.ceil((x_max - x_min) / CELL) + 1.0
    segments, circles = np.array(segments), np.array(circles)
    return Walls(segments, circles, _lists(segments, circles, x_min, y_min, rows, cols), (x_min, y_min, rows, cols))


@njit(cache=True, error_model="numpy", inline="always")
def offset(segments, circles, item, x, y):
    """Return the unit vector from the nearest point of an obstacle to (x, y), and the distance [m]."""
    num_segments = segments.shape[0]
    if item < num_segments:
        dx, dy = segment_offset(x, y, segments, item)
        distance = math.sqrt(dx * dx + dy * dy)
        scale, gap = 1.0 / max(distance, 1e-300), distance
    else:
        circle = circles[item - num_segments]
        dx, dy = x - circle[0], y - circle[1]
        distance = math.sqrt(dx * dx + dy * dy)
        scale, gap = 1.0 / max(distance, 1e-300), distance - circle[2]
    return dx * scale, dy * scale, gap


@njit(cache=True, error_model="numpy")
def _lists(segments, circles, origin_x, origin_y, rows, cols):
    """Return `Walls.near`: first it is counted how long each list becomes, then they are written."""
    num_items, num_cells, reach = segments.shape[0] + circles.shape[0], int(rows * cols), REACH + math.sqrt(0.5) * CELL
    near = np.zeros(num_cells + 2)
    for is_writing in (False, True):
        for item in range(num_items):
            if item < segments.shape[0]:
                x0, y0, x1, y1 = segments[item]
                size = 0.0
            else:
                x0, y0, size = circles[item - segments.shape[0]]
                x1, y1 = x0, y0
            left, low = min(x0, x1) - size - REACH - origin_x, min(y0, y1) - size - REACH - origin_y
            right, high = max(x0, x1) + size + REACH - origin_x, max(y0, y1) + size + REACH - origin_y
            for row in range(max(math.floor(low / CELL), 0), min(math.floor(high / CELL) + 1, int(rows))):
                for col in range(max(math.floor(left / CELL), 0), min(math.floor(right / CELL) + 1, int(cols))):
                    x, y = origin_x + (col + 0.5) * CELL, origin_y + (row + 0.5) * CELL
                    if offset(segments, circles, item, x, y)[2] <= reach:
                        cell = row * int(cols) + col
                        if is_writing:
                            near[int(near[cell + 1])] = item
                            near[cell + 1] += 1
                        else:
                            near[cell + 2] += 1
        if not is_writing:  # lists begin one entry late, and have moved to their place once they are written
            near[0] = near[1] = num_cells + 1
            for cell in range(num_cells):
                near[cell + 2] += near[cell + 1]
            lists = np.zeros(int(near[num_cells + 1]) + 1)
            lists[: num_cells + 1] = near[: num_cells + 1]
            near = lists
    return near


@njit(cache=True, error_model="numpy", inline="always")
def near_list(near, grid, x, y):
    """Return where the list of what is near (x, y) begins and ends in `Walls.near`; empty beyond the grid."""
    row, col = math.floor((y - grid[1]) / CELL), math.floor((x - grid[0]) / CELL)
    if not (0 <= row < grid[2] and 0 <= col < grid[3]):
        return 0, 0
    cell = int(row * grid[3] + col)
    return int(near[cell]), int(near[cell + 1])


@njit(cache=True, error_model="numpy", inline="always")
def clearance(segments, circles, near, grid, x, y):
    """Return the distance from (x, y) to the nearest obstacle of `Walls`, `REACH` where none is nearer [m]."""
    first, end = near_list(near, grid, x, y)
    nearest = REACH
    for k in range(first, end):
        nearest = min(nearest, offset(segments, circles, int(near[k]), x, y)[2])
    return nearest


@njit(cache=True, error_model="numpy", inline="always")
def push_out(segments, circles, near, grid, x, y, radius):
    """Push a disc out of the obstacles of `Walls` that it overlaps, the deepest overlap first.

    Returns its centre (x, y) [m], and whether it is free now; where it is wedged it is not.
    """
    for _ in range(_MAX_PUSHES):
        first, end = near_list(near, grid, x, y)
        deepest, push_x, push_y = _TOLERANCE, 0.0, 0.0
        for k in range(first, end):
            nx, ny, gap = offset(segments, circles, int(near[k]), x, y)
            if radius - gap > deepest:
                deepest, push_x, push_y = radius - gap, nx, ny
        if deepest == _TOLERANCE:
            return x, y, True
        x, y = x + deepest * push_x, y + deepest * push_y
    return x, y, False
