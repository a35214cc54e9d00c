"""Frontiers: free cells that border on unknown cells (Yamauchi, 1997), and their visibility.

Arrays: `occupancy`, shape (height, width), int8; `frontier` and `ignored` (excluded cells), same shape, bool;
`tile_counts`, int32, number of frontier cells per 32 x 32 cells. Cells are (row, column), distances are in cells.
"""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import OCCUPIED_FROM, OccupancyGrid, Window
from lidarnaut.envs.geometry.lines import cell_along
from lidarnaut.envs.geometry.pose import wrap_angle
from lidarnaut.envs.navigation.maps.planning_kernels import join_cells

TILE = 32
"""Side of square tiles with counts of frontier cells, to skip empty tiles [cells]."""


@njit(cache=True, error_model="numpy")
def update_frontier(occupancy, ignored, frontier, tile_counts, window):
    """Update the frontier in a rectangle of cells: free cells with an unknown 8-neighbour, except ignored cells."""
    top, left, bottom, right = window.row, window.col, window.row + window.height, window.col + window.width
    height, width = occupancy.shape
    first, last = max(left - 1, 0), min(right + 1, width)
    # A neighbourhood's minimum is negative if a cell is unknown. Whole rows allow vectorisation.
    lowest = np.zeros(last - first + 2, dtype=np.int8)
    for row in range(top, bottom):
        above = occupancy[max(row - 1, 0), first:last]
        middle = occupancy[row, first:last]
        below = occupancy[min(row + 1, height - 1), first:last]
        for k in range(last - first):
            lowest[k + 1] = min(above[k], middle[k], below[k])
        for col in range(left, right):
            k = col - first
            near = min(lowest[k], lowest[k + 1], lowest[k + 2])
            is_frontier = (middle[k] >= 0) & (middle[k] < OCCUPIED_FROM) & (near < 0) & (not ignored[row, col])
            if is_frontier != frontier[row, col]:
                frontier[row, col] = is_frontier
                tile_counts[row // TILE, col // TILE] += 1 if is_frontier else -1


def frontier_mask(grid: OccupancyGrid) -> np.ndarray:
    """Return a mask of free cells with an unknown 8-neighbour, shape (height, width), bool."""
    height, width = grid.data.shape
    frontier = np.zeros((height, width), dtype=np.bool_)
    tile_counts = np.zeros((height // TILE + 1, width // TILE + 1), dtype=np.int32)
    update_frontier(grid.data, np.zeros_like(frontier), frontier, tile_counts, Window(0, 0, height, width))
    return frontier


@njit(cache=True, error_model="numpy")
def ignore_around(ignored, frontier, tile_counts, cells):
    """Exclude cells (row, column), shape (n, 2), int64, and their 8-neighbours from the frontier."""
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
    """Group frontier cells into 8-connected components.

    Returns cells, shape (n, 2), int64, sorted by group, and the start index of each group, followed by n.
    """
    height, width = frontier.shape
    # Ungrouped frontier cells per tile, to skip tiles.
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
def _split(cells, first, last, extent, parts, count):
    stack = [(first, last)]
    while len(stack) > 0:
        a, b = stack.pop()
        low_row, high_row, low_col, high_col = cells[a, 0], cells[a, 0], cells[a, 1], cells[a, 1]
        for k in range(a + 1, b):
            low_row, high_row = min(low_row, cells[k, 0]), max(high_row, cells[k, 0])
            low_col, high_col = min(low_col, cells[k, 1]), max(high_col, cells[k, 1])
        tall, wide = high_row - low_row + 1, high_col - low_col + 1
        if max(tall, wide) <= extent:
            parts[count, 0], parts[count, 1] = a, b
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
    """Split groups of frontier cells into parts with bounding boxes of at most `extent` cells.

    `cells`, `starts`: from `frontier_groups`; `cells` is reordered. Groups below `least` cells are dropped. Returns
    shape (m, 4), int64: start and end index in `cells`, group size [cells], group index.
    """
    parts = np.empty((len(cells) + 1, 4), dtype=np.int64)
    count = 0
    for k in range(len(starts) - 1):
        if starts[k + 1] - starts[k] >= least:
            before = count
            count = _split(cells, starts[k], starts[k + 1], extent, parts, count)
            parts[before:count, 2], parts[before:count, 3] = starts[k + 1] - starts[k], k
    return parts[:count].copy()


@njit(cache=True, error_model="numpy")
def _count_unknown(data, cells, others, radius):
    height, width = data.shape
    counts = np.zeros(len(cells), dtype=np.int64)
    reach = int(radius)
    for k in range(len(cells)):
        row0, col0 = cells[k]
        row1, col1 = others[k]
        for row in range(max(row0, row1) - reach, min(row0, row1) + reach + 1):
            half0 = int(np.sqrt(radius * radius - (row - row0) ** 2))
            half1 = int(np.sqrt(radius * radius - (row - row1) ** 2))
            for col in range(max(col0 - half0, col1 - half1), min(col0 + half0, col1 + half1) + 1):
                counts[k] += row < 0 or row >= height or col < 0 or col >= width or data[row, col] < 0
    return counts


def information_gain(
    grid: OccupancyGrid, points: np.ndarray, radius: float, shared_with: np.ndarray | None = None
) -> np.ndarray:
    """Return the unknown area within `radius` [m] of each point, shape (n,), float64 [m2].

    `points`: shape (n, 2), map frame [m]. Cells outside the map are unknown. `shared_with`: count only area that is
    also within the radius of this point, shape (2,), map frame [m].
    """
    cells = grid.cells(points)
    others = cells if shared_with is None else np.broadcast_to(grid.cells(shared_with), cells.shape)
    areas: np.ndarray = _count_unknown(grid.data, cells, others, radius / grid.resolution) * grid.resolution**2
    return areas


@njit(cache=True, error_model="numpy")
def is_visible(data, row0, col0, row1, col1):
    """Return True if no occupied cell of `data` (int8) lies between two cells."""
    steps = max(abs(row1 - row0), abs(col1 - col0), 1)
    d_row, d_col = (row1 - row0) / steps, (col1 - col0) / steps
    for k in range(1, steps):
        row, col = cell_along(row0, col0, d_row, d_col, k)
        if data[row, col] >= OCCUPIED_FROM:
            return False
    return True


@njit(cache=True, error_model="numpy")
def is_frontier_near(data, block, ignored, row, col, reach):
    """Return True if a frontier cell is within `reach` planning cells (blocks of map cells) of (row, col).

    Faster than an update of the whole frontier. `data`: occupancy of the map, int8. `block`: side of a planning cell
    [map cells].
    """
    height, width = ignored.shape
    top, left = max(row - reach - 1, 0), max(col - reach - 1, 0)
    bottom, right = min(row + reach + 2, height), min(col + reach + 2, width)
    if top >= bottom or left >= right:
        return False
    shape = bottom - top, right - left
    window = Window(0, 0, shape[0], shape[1])
    occupancy, frontier = np.empty(shape, dtype=np.int8), np.zeros(shape, dtype=np.bool_)
    join_cells(data[top * block :, left * block :], block, occupancy, window)
    tile_counts = np.zeros((shape[0] // TILE + 1, shape[1] // TILE + 1), dtype=np.int32)
    update_frontier(occupancy, ignored[top:bottom, left:right], frontier, tile_counts, window)
    return len(frontier_near(frontier, row - top, col - left, reach)) > 0


@njit(cache=True, error_model="numpy")
def frontier_near(frontier, row, col, reach):
    """Return the frontier cells within `reach` cells of (row, col), shape (k, 2), int64."""
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
def frontier_in_sight(occupancy, frontier, at, view, reach):
    """Return the frontier cells within `reach` cells, in field of view and line of sight, shape (k, 2), int64.

    `at`: viewpoint (row, column), fractional. `view`: centre and half width of the field of view [rad].
    """
    row, col = math.floor(at[0]), math.floor(at[1])
    cells = frontier_near(frontier, row, col, reach)
    count = 0
    for k in range(len(cells)):
        bearing = math.atan2(cells[k, 0] + 0.5 - at[0], cells[k, 1] + 0.5 - at[1])
        is_ahead = abs(wrap_angle(bearing - view[0])) <= view[1]
        if is_ahead and is_visible(occupancy, row, col, cells[k, 0], cells[k, 1]):
            cells[count, 0], cells[count, 1] = cells[k, 0], cells[k, 1]
            count += 1
    return cells[:count]
