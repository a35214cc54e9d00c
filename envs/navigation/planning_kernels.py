"""Planning cells, costs and frontiers, recomputed in a window. Kernels of `envs.navigation.planning_map`."""

import math

import numpy as np
from numba import njit

from envs.geometry.pose import wrap_angle
from envs.navigation.costmap import inflate
from envs.navigation.frontiers import FREE_BELOW
from envs.navigation.obstacles import mark_missing, points_within
from envs.navigation.viewpoints import is_visible

OCCUPIED_FROM = 50
"""Least occupancy that is an obstacle [percent]."""
TILE = 32
"""Side of the tiles in which frontier cells are counted [cells]."""


@njit(cache=True, error_model="numpy")
def join_cells(data, block, joined, window):
    """Join `block` x `block` map cells to one: the greatest occupancy, unknown (-1) where none is known.

    Args:
        data: shape (rows, cols), int8, occupancy.
        block: side of a joined cell [map cells].
        joined: shape (height, width), int8, written in the window.
        window: first row, first column, row after the last, column after the last [joined cells].
    """
    top, left, bottom, right = window
    rows, cols = data.shape
    width = right - left
    lines = np.empty(width * block, dtype=np.int8)
    for row in range(top, bottom):
        lines[:] = -1
        for r in range(row * block, min((row + 1) * block, rows)):
            line = data[r, left * block : min(right * block, cols)]
            for k in range(line.shape[0]):
                lines[k] = max(lines[k], line[k])
        out = joined[row, left:right]
        if block == 2:
            for k in range(width):
                out[k] = max(lines[2 * k], lines[2 * k + 1])
        else:
            for k in range(width):
                out[k] = -1
                for i in range(block):
                    out[k] = max(out[k], lines[k * block + i])


@njit(cache=True, error_model="numpy")
def update_frontier(joined, ignored, frontier, tile_counts, window):
    """Mark free cells with an unknown cell among their eight neighbours, but for those that are ignored.

    Args:
        joined: shape (height, width), int8, occupancy.
        ignored: shape (height, width), bool.
        frontier: shape (height, width), bool, written in the window.
        tile_counts: shape (tile rows, tile columns), int32: frontier cells in each tile, kept up to date.
        window: first row, first column, row after the last, column after the last.
    """
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
def frontier_groups(frontier, tile_counts):
    """Group frontier cells that touch, also diagonally, in time that grows with their number.

    Args:
        frontier: shape (height, width), bool; the same afterwards.
        tile_counts: shape (tile rows, tile columns), int32.

    Returns:
        Cells, shape (n, 2), int64, (row, column), group after group; and where each group begins, followed by n.
    """
    height, width = frontier.shape
    total = 0
    for i in range(tile_counts.shape[0]):
        for j in range(tile_counts.shape[1]):
            total += tile_counts[i, j]
    cells = np.empty((total, 2), dtype=np.int64)
    starts = [0]
    count = 0
    for i in range(tile_counts.shape[0]):
        for j in range(tile_counts.shape[1]):
            if tile_counts[i, j] == 0:
                continue
            for row in range(i * TILE, min((i + 1) * TILE, height)):
                for col in range(j * TILE, min((j + 1) * TILE, width)):
                    if not frontier[row, col]:
                        continue
                    frontier[row, col] = False
                    cells[count, 0], cells[count, 1] = row, col
                    head, count = count, count + 1
                    while head < count:
                        r0, c0 = cells[head, 0], cells[head, 1]
                        head += 1
                        for r in range(max(r0 - 1, 0), min(r0 + 2, height)):
                            for c in range(max(c0 - 1, 0), min(c0 + 2, width)):
                                if frontier[r, c]:
                                    frontier[r, c] = False
                                    cells[count, 0], cells[count, 1] = r, c
                                    count += 1
                    starts.append(count)
    for k in range(count):
        frontier[cells[k, 0], cells[k, 1]] = True
    return cells, np.array(starts)


@njit(cache=True, error_model="numpy")
def cells_of(points, left, low, side):
    """Return the cells of points: shape (k, 2), int64, (row, column).

    Args:
        points: shape (k, 2), float64 [m].
        left: where the first column begins [m].
        low: where the first row begins [m].
        side: of a cell [m].
    """
    cells = np.empty((len(points), 2), dtype=np.int64)
    for k in range(len(points)):
        cells[k, 0] = math.floor((points[k, 1] - low) / side)
        cells[k, 1] = math.floor((points[k, 0] - left) / side)
    return cells


@njit(cache=True, error_model="numpy")
def obstacle_cells(points, marking_range, pose, origin, side):
    """Return the cells of obstacles near the robot: shape (k, 2), int64, (row, column), also outside the map.

    Args:
        points: shape (n, 2), float64, base frame [m].
        marking_range: farther ones are left out [m].
        pose: of the robot (x, y, theta), map frame.
        origin: where the first column and the first row begin, map frame [m].
        side: of a cell [m].
    """
    near = points_within(points, marking_range)
    x, y, theta = pose
    c, s = math.cos(theta), math.sin(theta)
    for k in range(len(near)):
        u, v = near[k, 0], near[k, 1]
        near[k, 0], near[k, 1] = x + c * u - s * v, y + s * u + c * v
    return cells_of(near, origin[0], origin[1], side)


@njit(cache=True, error_model="numpy")
def update_costs(joined, obstacles, bodies, tables, costs, open_weights, window):
    """Inflate the obstacles of the map, and of those in sight that it misses.

    Args:
        joined: shape (height, width), int8, occupancy.
        obstacles: shape (n, 2), int64, (row, column), also outside: marked where no occupied cell accounts for them.
        bodies: shape (m, 2), int64, (row, column), also outside: marked in any case.
        tables: `PlanningTables`.
        costs: shape (height, width), uint8, written in the window.
        open_weights: shape ((height + 2) * (width + 2),), uint8, written in the window; see `expand`.
        window: first row, first column, row after the last, column after the last.
    """
    top, left, bottom, right = window
    height, width = joined.shape
    # Obstacles beside the window cost in it, and cells that account for an obstacle may lie beside those.
    reach = tables.inflation + tables.same_obstacle
    first_row, first_col = max(top - reach, 0), max(left - reach, 0)
    part = joined[first_row : min(bottom + reach, height), first_col : min(right + reach, width)]
    corner = np.array([first_row, first_col])
    marked = mark_missing(part, obstacles - corner, tables.same_obstacle, OCCUPIED_FROM)
    for k in range(bodies.shape[0]):
        row, col = bodies[k, 0] - first_row, bodies[k, 1] - first_col
        if 0 <= row < marked.shape[0] and 0 <= col < marked.shape[1]:
            marked[row, col] = 100
    found = inflate(marked, OCCUPIED_FROM, tables.inflation, tables.costs)
    for row in range(top, bottom):
        node = (row + 1) * (width + 2) + left + 1
        for col in range(left, right):
            cost = found[row - first_row, col - first_col]
            costs[row, col] = cost
            open_weights[node + col - left] = tables.weights[cost]


@njit(cache=True, error_model="numpy")
def is_frontier_near(data, block, ignored, row, col, reach):
    """Tell whether there is a frontier cell within `reach` cells of (row, column), on the map as it is now.

    Args:
        data: shape (rows, cols), int8, occupancy of the map.
        block: side of a planning cell [map cells].
        ignored: shape (height, width), bool, by planning cell.
        row: row of the planning cell in the middle.
        col: its column.
        reach: how far is looked [planning cells].
    """
    height, width = ignored.shape
    top, left = max(row - reach - 1, 0), max(col - reach - 1, 0)
    bottom, right = min(row + reach + 2, height), min(col + reach + 2, width)
    if top >= bottom or left >= right:
        return False
    around = np.empty((bottom - top, right - left), dtype=np.int8)
    for r in range(top, bottom):
        for c in range(left, right):
            highest = np.int8(-1)
            for i in range(r * block, min((r + 1) * block, data.shape[0])):
                for j in range(c * block, min((c + 1) * block, data.shape[1])):
                    highest = max(highest, data[i, j])
            around[r - top, c - left] = highest
    for r in range(max(row - reach, 0), min(row + reach + 1, height)):
        for c in range(max(col - reach, 0), min(col + reach + 1, width)):
            if ignored[r, c] or (r - row) ** 2 + (c - col) ** 2 > reach * reach:
                continue
            if not 0 <= around[r - top, c - left] < FREE_BELOW:
                continue
            for i in range(max(r - 1, top), min(r + 2, bottom)):
                for j in range(max(c - 1, left), min(c + 2, right)):
                    if around[i - top, j - left] < 0:
                        return True
    return False


@njit(cache=True, error_model="numpy")
def frontier_near(frontier, row, col, reach):
    """Return the frontier cells within `reach` cells of (row, column): shape (k, 2), int64."""
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
    """Return the frontier cells in view of a point, with no obstacle between: shape (k, 2), int64.

    Args:
        joined: shape (height, width), int8, occupancy.
        frontier: shape (height, width), bool.
        at: the viewpoint (row, column), with fractions [cells].
        view: middle of the view, and half of the angle in view [rad].
        reach: how far is looked [cells].
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
