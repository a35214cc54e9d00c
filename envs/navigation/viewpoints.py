"""From which cell to look at a frontier, and what is in sight."""

from numba import njit

from envs.geometry.lines import cell_along

OCCUPIED_FROM = 50
"""Occupancy from which a cell blocks the view [percent]."""


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
    """Find the cell with the least travel cost within `reach` cells of any of `cells` and in sight of it.

    Args:
        data: shape (height, width), int8, occupancy.
        travel: shape (height + 2, width + 2), int32, with a border of one cell.
        cells: shape (k, 2), int64, (row, column).
        reach: radius [cells].

    Returns:
        Row and column of the viewpoint, and the index of the cell in view; -1, -1, -1 if there is none.
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
