"""From which cell to look at a frontier, and what is in sight. Kernels.

`joined`, shape (height, width), int8, is the occupancy of planning cells; `frontier` and `ignored`, same shape, bool.
Cells are (row, column), distances count cells.
"""

import math

import numpy as np
from numba import njit

from envs.geometry.lines import cell_along
from envs.geometry.pose import wrap_angle
from envs.navigation.frontiers import OCCUPIED_FROM, TILE, update_frontier
from envs.navigation.planning_kernels import join_cells


@njit(cache=True, error_model="numpy")
def is_visible(data, row0, col0, row1, col1):
    """Tell whether no occupied cell of `data` (shape (height, width), int8, occupancy) lies between two cells."""
    steps = max(abs(row1 - row0), abs(col1 - col0))
    d_row, d_col = (row1 - row0) / steps, (col1 - col0) / steps
    for k in range(1, steps):
        row, col = cell_along(row0, col0, d_row, d_col, k)
        if data[row, col] >= OCCUPIED_FROM:
            return False
    return True


@njit(cache=True, error_model="numpy")
def cheapest_view(data, travel, cells, reach):
    """Find the cell with the least travel cost within `reach` of any of `cells`, shape (k, 2), and in sight of it.

    `travel` has a border of one cell. Returns row and column of the viewpoint, and the index of the cell in view; -1,
    -1, -1 if there is none.
    """
    height, width = data.shape
    best, best_row, best_col, seen = travel[0, 0], -1, -1, -1
    for k in range(cells.shape[0]):
        row, col = cells[k]
        for r in range(max(row - reach, 0), min(row + reach + 1, height)):
            for c in range(max(col - reach, 0), min(col + reach + 1, width)):
                if travel[r + 1, c + 1] >= best or (r - row) ** 2 + (c - col) ** 2 > reach * reach:
                    continue
                if is_visible(data, r, c, row, col):
                    best, best_row, best_col, seen = travel[r + 1, c + 1], r, c, k
    return best_row, best_col, seen


@njit(cache=True, error_model="numpy")
def is_frontier_near(data, block, ignored, row, col, reach):
    """Tell whether there is a frontier cell within `reach` of a planning cell, on the map as it is now.

    `data`, shape (rows, cols), int8, is the map itself, with `block` x `block` of its cells in a planning cell.
    """
    height, width = ignored.shape
    top, left = max(row - reach - 1, 0), max(col - reach - 1, 0)
    bottom, right = min(row + reach + 2, height), min(col + reach + 2, width)
    if top >= bottom or left >= right:
        return False
    window = (0, 0, bottom - top, right - left)
    shape = window[2:]
    around, frontier = np.empty(shape, dtype=np.int8), np.zeros(shape, dtype=np.bool_)
    join_cells(data[top * block :, left * block :], block, around, window)
    tile_counts = np.zeros((shape[0] // TILE + 1, shape[1] // TILE + 1), dtype=np.int32)
    update_frontier(around, ignored[top:bottom, left:right], frontier, tile_counts, window)
    return len(frontier_near(frontier, row - top, col - left, reach)) > 0


@njit(cache=True, error_model="numpy")
def frontier_near(frontier, row, col, reach):
    """Return the frontier cells within `reach` of (row, col): shape (k, 2), int64."""
    height, width = frontier.shape
    cells = np.empty(((2 * reach + 1) ** 2, 2), dtype=np.int64)
    count = 0
    for r in range(max(row - reach, 0), min(row + reach + 1, height)):
        for c in range(max(col - reach, 0), min(col + reach + 1, width)):
            if frontier[r, c] and (r - row) ** 2 + (c - col) ** 2 <= reach * reach:
                cells[count, 0], cells[count, 1] = r, c
                count += 1
    return cells[:count]


@njit(cache=True, error_model="numpy")
def frontier_in_sight(joined, frontier, at, view, reach):
    """Return the frontier cells within `reach` that are in view with no obstacle between: shape (k, 2), int64.

    `at` is the viewpoint (row, column), with fractions; `view` its middle and half of the angle in view [rad].
    """
    row, col = math.floor(at[0]), math.floor(at[1])
    cells = frontier_near(frontier, row, col, reach)
    count = 0
    for k in range(len(cells)):
        bearing = math.atan2(cells[k, 0] + 0.5 - at[0], cells[k, 1] + 0.5 - at[1])
        is_ahead = abs(wrap_angle(bearing - view[0])) <= view[1]
        if is_ahead and is_visible(joined, row, col, cells[k, 0], cells[k, 1]):
            cells[count, 0], cells[count, 1] = cells[k, 0], cells[k, 1]
            count += 1
    return cells[:count]
