"""Frontiers: where what is known to be free borders on what is unknown (Yamauchi, 1997).

Kernels share four arrays: `joined`, shape (height, width), int8, occupancy; `ignored` and `frontier`, same shape, bool;
and `tile_counts`, shape (tile rows, tile columns), int32, the number of frontier cells in each tile, kept up to date.
"""

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid

FREE_BELOW = 50
"""Occupancy from which a cell no longer counts as free [percent]."""
OCCUPIED_FROM = 50
"""Least occupancy of a planning cell that is an obstacle, and blocks the view [percent]."""
TILE = 32
"""Side of the tiles in which frontier cells are counted [cells]."""


@njit(cache=True, error_model="numpy")
def update_frontier(joined, ignored, frontier, tile_counts, window):
    """Mark free cells with an unknown cell among their eight neighbours, in a `Window`, but for ignored ones."""
    top, left, bottom, right = window
    height, width = joined.shape
    first, last = max(left - 1, 0), min(right + 1, width)
    # The least value in the three rows around a cell, then the least of three columns, is negative exactly where one of
    # the nine cells is unknown. Whole rows, so that the compiler vectorises it.
    lowest = np.zeros(last - first + 2, dtype=np.int8)
    for row in range(top, bottom):
        above = joined[max(row - 1, 0), first:last]
        middle = joined[row, first:last]
        below = joined[min(row + 1, height - 1), first:last]
        for k in range(last - first):
            lowest[k + 1] = min(above[k], middle[k], below[k])
        for col in range(left, right):
            k = col - first
            near = min(lowest[k], lowest[k + 1], lowest[k + 2])
            is_frontier = (middle[k] >= 0) & (middle[k] < FREE_BELOW) & (near < 0) & (not ignored[row, col])
            if is_frontier != frontier[row, col]:
                frontier[row, col] = is_frontier
                tile_counts[row // TILE, col // TILE] += 1 if is_frontier else -1


def frontier_mask(grid: OccupancyGrid) -> np.ndarray:
    """Mark the frontier cells of a map: free ones with an unknown one among their eight neighbours.

    Returns:
        Shape of the map, bool.
    """
    height, width = grid.data.shape
    frontier = np.zeros((height, width), dtype=np.bool_)
    tile_counts = np.zeros((height // TILE + 1, width // TILE + 1), dtype=np.int32)
    update_frontier(grid.data, np.zeros_like(frontier), frontier, tile_counts, (0, 0, height, width))
    return frontier


@njit(cache=True, error_model="numpy")
def ignore_around(ignored, frontier, tile_counts, cells):
    """Ignore cells and their eight neighbours as frontier from now on; cells: shape (n, 2), int64, (row, column)."""
    height, width = ignored.shape
    for k in range(cells.shape[0]):
        for row in range(max(cells[k, 0] - 1, 0), min(cells[k, 0] + 2, height)):
            for col in range(max(cells[k, 1] - 1, 0), min(cells[k, 1] + 2, width)):
                ignored[row, col] = True
                if frontier[row, col]:
                    frontier[row, col] = False
                    tile_counts[row // TILE, col // TILE] -= 1


@njit(cache=True, error_model="numpy")
def _flood(frontier, left, row, col, cells, count):
    """Move the frontier cells that are connected to one to `cells`, from row `count` on; return the next row."""
    height, width = frontier.shape
    frontier[row, col] = False
    left[row // TILE, col // TILE] -= 1
    cells[count, 0], cells[count, 1] = row, col
    head, count = count, count + 1
    while head < count:
        r0, c0 = cells[head, 0], cells[head, 1]
        head += 1
        for r in range(max(r0 - 1, 0), min(r0 + 2, height)):
            for c in range(max(c0 - 1, 0), min(c0 + 2, width)):
                if frontier[r, c]:
                    frontier[r, c] = False
                    left[r // TILE, c // TILE] -= 1
                    cells[count, 0], cells[count, 1] = r, c
                    count += 1
    return count


@njit(cache=True, error_model="numpy")
def frontier_groups(frontier, tile_counts):
    """Group frontier cells that touch, also diagonally, in time that grows with their number.

    Returns:
        Cells, shape (n, 2), int64, (row, column), group after group; and where each group begins, followed by n.
    """
    height, width = frontier.shape
    # Frontier cells of each tile that are in no group yet: where none are left, the rest of the tile need not be read.
    left = tile_counts.copy()
    cells = np.empty((left.sum(), 2), dtype=np.int64)
    starts = [0]
    count = 0
    for i in range(left.shape[0]):
        for j in range(left.shape[1]):
            for row in range(i * TILE, min((i + 1) * TILE, height)):
                if left[i, j] == 0:
                    break
                for col in range(j * TILE, min((j + 1) * TILE, width)):
                    if frontier[row, col]:
                        count = _flood(frontier, left, row, col, cells, count)
                        starts.append(count)
    for k in range(count):
        frontier[cells[k, 0], cells[k, 1]] = True
    return cells, np.array(starts)


@njit(cache=True, error_model="numpy")
def _split(cells, first, last, extent, bounds, count):
    """Split the cells from `first` to `last` - 1 in place, until no part's bounding box is longer than `extent`.

    Writes the first cell of each part, and the cell after its last, to `bounds` from row `count` on, and returns how
    many parts there are now.
    """
    stack = [(first, last)]
    while len(stack) > 0:
        a, b = stack.pop()
        low_row, high_row, low_col, high_col = cells[a, 0], cells[a, 0], cells[a, 1], cells[a, 1]
        for k in range(a + 1, b):
            low_row, high_row = min(low_row, cells[k, 0]), max(high_row, cells[k, 0])
            low_col, high_col = min(low_col, cells[k, 1]), max(high_col, cells[k, 1])
        tall, wide = high_row - low_row + 1, high_col - low_col + 1
        if max(tall, wide) <= extent:
            bounds[count, 0], bounds[count, 1] = a, b
            count += 1
            continue
        axis = 0 if tall >= wide else 1
        middle = (low_row + high_row) // 2 if axis == 0 else (low_col + high_col) // 2
        i = a
        for k in range(a, b):
            if cells[k, axis] <= middle:
                r, c = cells[k]
                cells[k, 0], cells[k, 1] = cells[i, 0], cells[i, 1]
                cells[i, 0], cells[i, 1] = r, c
                i += 1
        stack.append((i, b))
        stack.append((a, i))
    return count


@njit(cache=True, error_model="numpy")
def split_groups(cells, starts, extent, least):
    """Split groups of frontier cells into parts that are no longer than `extent` [cells].

    Args:
        cells: shape (n, 2), int64, reordered within the groups.
        starts: where each group begins, followed by n.
        extent: [cells].
        least: smaller groups are left out [cells].

    Returns:
        Shape (m, 4), int64: first cell of each part, cell after its last, size of its group [cells], and which group.
    """
    bounds = np.empty((len(cells) + 1, 2), dtype=np.int64)
    groups = np.empty((len(cells) + 1, 2), dtype=np.int64)
    count = 0
    for k in range(len(starts) - 1):
        if starts[k + 1] - starts[k] >= least:
            before = count
            count = _split(cells, starts[k], starts[k + 1], extent, bounds, count)
            groups[before:count, 0], groups[before:count, 1] = starts[k + 1] - starts[k], k
    parts = np.empty((count, 4), dtype=np.int64)
    parts[:, :2] = bounds[:count]
    parts[:, 2:] = groups[:count]
    return parts


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
