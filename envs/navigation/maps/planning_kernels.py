"""Compiled functions of the planning map: update occupancy, marked obstacles and costs.

Planning cells are blocks of map cells. `occupancy`, `marks`: occupancy of planning cells by map and by scans, shape
(height, width), int8. Cells are (row, column), shape (n, 2), int64, possibly outside the raster.
"""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import FREE, OCCUPIED, OCCUPIED_FROM
from lidarnaut.envs.geometry.lines import next_cell, start_walk
from lidarnaut.envs.navigation.maps.costmap import inflate
from lidarnaut.envs.navigation.maps.obstacles import points_within


@njit(cache=True, error_model="numpy")
def join_cells(data, block, occupancy, window):
    """Fill a rectangle of planning cells with the maximum of their `block` x `block` map cells; -1 is unknown."""
    top, left, height, width = window
    rows, cols = data.shape
    lines = np.empty(width * block, dtype=np.int8)
    for row in range(top, top + height):
        lines[:] = -1
        for r in range(row * block, min((row + 1) * block, rows)):
            line = data[r, left * block : min((left + width) * block, cols)]
            for k in range(line.shape[0]):
                lines[k] = max(lines[k], line[k])
        out = occupancy[row, left : left + width]
        if block == 2:
            for k in range(width):
                out[k] = max(lines[2 * k], lines[2 * k + 1])
        else:
            for k in range(width):
                out[k] = -1
                for i in range(block):
                    out[k] = max(out[k], lines[k * block + i])


@njit(cache=True, error_model="numpy")
def cells_of(points, left, low, side):
    """Return the cells (row, column) that contain points, shape (k, 2) [m]; `left`, `low`: raster origin [m]."""
    cells = np.empty((len(points), 2), dtype=np.int64)
    for k in range(len(points)):
        cells[k, 0] = math.floor((points[k, 1] - low) / side)
        cells[k, 1] = math.floor((points[k, 0] - left) / side)
    return cells


@njit(cache=True, error_model="numpy")
def obstacle_cells(points, marking_range, pose, origin, side):
    """Return the cells of points, shape (n, 2), base frame [m], within `marking_range` [m] of the robot.

    `origin`: raster origin, map frame [m]. `side`: cell side [m].
    """
    near = points_within(points, marking_range)
    x, y, theta = pose
    c, s = math.cos(theta), math.sin(theta)
    for k in range(len(near)):
        u, v = near[k, 0], near[k, 1]
        near[k, 0], near[k, 1] = x + c * u - s * v, y + s * u + c * v
    return cells_of(near, origin[0], origin[1], side)


@njit(cache=True, error_model="numpy")
def clear_beams(marks, start, ends, origin, side):
    """Mark the cells along lidar beams as free.

    `start`: lidar position; `ends`: ends of beams, shape (n, 2), map frame [m]. `origin`, `side`: see `obstacle_cells`.
    """
    height, width = marks.shape
    x, y = (start[0] - origin[0]) / side, (start[1] - origin[1]) / side
    for k in range(len(ends)):
        walk = start_walk(x, y, (ends[k, 0] - origin[0]) / side, (ends[k, 1] - origin[1]) / side)
        while 0 <= walk.row < height and 0 <= walk.col < width:
            marks[walk.row, walk.col] = FREE
            if walk.rows_left + walk.cols_left == 0:
                break
            walk = next_cell(walk)


@njit(cache=True, error_model="numpy")
def mark(marks, occupancy, cells, reach):
    """Mark cells as occupied, except within `reach` cells of an occupied map cell; `reach` -1: no exceptions."""
    height, width = occupancy.shape
    for k in range(cells.shape[0]):
        row, col = cells[k]
        if row < 0 or col < 0 or row >= height or col >= width:
            continue
        is_known = False
        for r in range(max(row - reach, 0), min(row + reach + 1, height)):
            for c in range(max(col - reach, 0), min(col + reach + 1, width)):
                is_known |= occupancy[r, c] >= OCCUPIED_FROM
        if not is_known:
            marks[row, col] = OCCUPIED


@njit(cache=True, error_model="numpy")
def update_costs(occupancy, marks, obstacles, bodies, tables, costs, open_weights, window):
    """Update traversal costs in a rectangle of cells by inflation of mapped, marked and visible obstacles.

    `obstacles`: cells of scanned obstacles, ignored near occupied map cells. `bodies`: obstacle cells that are never
    ignored. Writes `costs`, shape (height, width), uint8, and `open_weights`, the cell weights for path search.
    """
    top, left, bottom, right = window.row, window.col, window.row + window.height, window.col + window.width
    height, width = occupancy.shape
    # Obstacles outside the window inflate into it; map cells farther outside may explain them.
    reach = tables.inflation + tables.same_obstacle
    first_row, first_col = max(top - reach, 0), max(left - reach, 0)
    last_row, last_col = min(bottom + reach, height), min(right + reach, width)
    part, corner = occupancy[first_row:last_row, first_col:last_col], np.array([first_row, first_col])
    combined = np.maximum(part, marks[first_row:last_row, first_col:last_col])
    mark(combined, part, obstacles - corner, tables.same_obstacle)
    mark(combined, part, bodies - corner, -1)
    found = inflate(combined, tables.inflation, tables.costs)
    for row in range(top, bottom):
        node = (row + 1) * (width + 2) + left + 1
        for col in range(left, right):
            cost = found[row - first_row, col - first_col]
            costs[row, col] = cost
            open_weights[node + col - left] = tables.weights[cost]
