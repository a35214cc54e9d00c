"""What is left of a frontier around a place, and what of it is in sight. Kernels."""

import math

import numpy as np
from numba import njit

from envs.geometry.pose import wrap_angle
from envs.navigation.frontiers import mark_frontier
from envs.navigation.viewpoints import is_visible


@njit(cache=True, error_model="numpy")
def _join_around(data, block, row, col, reach):
    """Join map cells to planning cells, as `join_cells` does, in a square that may stick out of the map.

    Args:
        data: shape (rows, cols), int8, occupancy.
        block: side of a planning cell [map cells].
        row: row of the planning cell in the middle.
        col: its column.
        reach: planning cells on each side of it, without a rim of one more.

    Returns:
        Shape (2 reach + 3, 2 reach + 3), int8.
    """
    size = 2 * reach + 3
    rows, cols = data.shape
    first_row, first_col = row - reach - 1, col - reach - 1
    joined = np.full((size, size), -1, dtype=np.int8)
    for i in range(size):
        for r in range(max((first_row + i) * block, 0), min((first_row + i + 1) * block, rows)):
            for j in range(size):
                for c in range(max((first_col + j) * block, 0), min((first_col + j + 1) * block, cols)):
                    joined[i, j] = max(joined[i, j], data[r, c])
    return joined


@njit(cache=True, error_model="numpy")
def frontier_near(data, left, low, resolution, block, x, y, radius, given_up):
    """Find the frontier around a place.

    Args:
        data: shape (rows, cols), int8, occupancy.
        left: where its first column begins, map frame [m].
        low: where its first row begins [m].
        resolution: side of its cells [m].
        block: side of a planning cell [map cells].
        x: the place, map frame [m].
        y: the same [m].
        radius: how far around [m].
        given_up: shape (m, 2), float64: cells here and their neighbours do not count, map frame [m].

    Returns:
        Shape (k, 2), float64: centres of frontier cells [m].
    """
    side = block * resolution
    row, col = math.floor((y - low) / side), math.floor((x - left) / side)
    reach = math.ceil(radius / side - 1e-9)
    joined = _join_around(data, block, row, col, reach)
    size, first_row, first_col = len(joined), row - reach - 1, col - reach - 1
    mask = mark_frontier(joined)
    # The rim is only there to be looked at from within.
    mask[0], mask[-1], mask[:, 0], mask[:, -1] = False, False, False, False
    for k in range(given_up.shape[0]):
        i = math.floor((given_up[k, 1] - low) / side) - first_row
        j = math.floor((given_up[k, 0] - left) / side) - first_col
        if -1 <= i <= size and -1 <= j <= size:
            mask[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2] = False
    cells = np.empty((size * size, 2))
    count = 0
    for i in range(size):
        for j in range(size):
            if mask[i, j] and (i - reach - 1) ** 2 + (j - reach - 1) ** 2 <= reach * reach:
                cells[count, 0] = left + (first_col + j + 0.5) * side
                cells[count, 1] = low + (first_row + i + 0.5) * side
                count += 1
    return cells[:count]


@njit(cache=True, error_model="numpy")
def frontier_in_sight(data, left, low, resolution, block, x, y, heading, half_view, radius, given_up):
    """Find the frontier around a robot that it has in view, with no obstacle between.

    Args:
        data: see `frontier_near`.
        left: see `frontier_near`.
        low: see `frontier_near`.
        resolution: see `frontier_near`.
        block: see `frontier_near`.
        x: where the robot is, map frame [m].
        y: the same [m].
        heading: middle of its view [rad].
        half_view: half of the angle in view [rad].
        radius: how far it looks [m].
        given_up: see `frontier_near`.

    Returns:
        Shape (k, 2), float64: centres of frontier cells [m].
    """
    cells = frontier_near(data, left, low, resolution, block, x, y, radius, given_up)
    side = block * resolution
    row, col = math.floor((y - low) / side), math.floor((x - left) / side)
    reach = math.ceil(radius / side - 1e-9)
    joined = _join_around(data, block, row, col, reach)
    count = 0
    for k in range(len(cells)):
        u, v = cells[k]
        there_row, there_col = math.floor((v - low) / side), math.floor((u - left) / side)
        is_ahead = abs(wrap_angle(math.atan2(v - y, u - x) - heading)) <= half_view
        middle = reach + 1
        if is_ahead and is_visible(joined, middle, middle, there_row - row + middle, there_col - col + middle):
            cells[count, 0], cells[count, 1] = u, v
            count += 1
    return cells[:count]
