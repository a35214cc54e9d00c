"""What a map says about travel, on planning cells. Kernels."""

import math

import numpy as np
from numba import njit

from envs.frontier_choice.tables import OCCUPIED_FROM
from envs.navigation.astar import UNREACHED, search
from envs.navigation.costmap import COST_INSCRIBED, COST_MAX_FREE, inflate, known_window
from envs.navigation.obstacles import mark_missing, points_within
from envs.navigation.paths import nearest_cell, shorten, walk_back


@njit(cache=True, error_model="numpy")
def join_cells(data, block, row, col, height, width):
    """Join `block` x `block` map cells to one: the greatest occupancy, unknown (-1) where none is known.

    Args:
        data: shape (rows, cols), int8, occupancy.
        block: side of a joined cell [map cells].
        row: first row of the result [joined cells].
        col: first column of the result.
        height: rows of the result.
        width: columns of the result.

    Returns:
        Shape (height, width), int8.
    """
    rows, cols = data.shape
    joined = np.full((height, width), -1, dtype=np.int8)
    lines = np.empty(width * block, dtype=np.int8)
    for i in range(height):
        lines[:] = -1
        for r in range((row + i) * block, min((row + i + 1) * block, rows)):
            line = data[r, col * block : min((col + width) * block, cols)]
            for k in range(line.shape[0]):
                lines[k] = max(lines[k], line[k])
        if block == 2:
            for j in range(width):
                joined[i, j] = max(lines[2 * j], lines[2 * j + 1])
        else:
            for j in range(width):
                for k in range(block):
                    joined[i, j] = max(joined[i, j], lines[j * block + k])
    return joined


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
def _in_map(points, x, y, theta):
    """Carry points from the base frame into the map frame, both shape (k, 2), float64 [m]."""
    c, s = math.cos(theta), math.sin(theta)
    carried = np.empty_like(points)
    for k in range(len(points)):
        u, v = points[k, 0], points[k, 1]
        carried[k, 0], carried[k, 1] = x + c * u - s * v, y + s * u + c * v
    return carried


@njit(cache=True, error_model="numpy")
def survey_map(data, resolution, origin_x, origin_y, x, y, theta, points, tables):
    """Look at the observed part of a map.

    Args:
        data: shape (rows, cols), int8, occupancy.
        resolution: side of a map cell [m].
        origin_x: position of its corner, map frame [m].
        origin_y: the same [m].
        x: believed position of the robot, map frame [m].
        y: the same [m].
        theta: believed heading [rad].
        points: shape (n, 2), float64, obstacles that the robot sees, base frame [m].
        tables: `SurveyTables`.

    Returns:
        Joined cells, shape (height, width), int8; costs, same shape, uint8; first row and column of both in the map
        [planning cells]; and the (row, column) in them where the robot stands, (-1, -1) if it cannot stand anywhere.
    """
    block = tables.block
    top, left, bottom, right = known_window(data)
    # A cell more on each side, so that what is known has unknown neighbours.
    row, col = max(top // block - 1, 0), max(left // block - 1, 0)
    rows, cols = (data.shape[0] + block - 1) // block, (data.shape[1] + block - 1) // block
    height, width = min(bottom // block + 2, rows) - row, min(right // block + 2, cols) - col
    joined = join_cells(data, block, row, col, height, width)
    side = block * resolution
    seen = _in_map(points_within(points, tables.marking_range), x, y, theta)
    cells = cells_of(seen, origin_x + col * side, origin_y + row * side, side)
    marked = mark_missing(joined, cells, tables.same_obstacle, OCCUPIED_FROM)
    costs = inflate(marked, OCCUPIED_FROM, tables.inflation, tables.costs)
    stand_row = math.floor((y - origin_y) / side) - row
    stand_col = math.floor((x - origin_x) / side) - col
    stand = nearest_cell(costs, tables.weights, stand_row, stand_col, tables.radius, COST_INSCRIBED)
    return joined, costs, row, col, stand


@njit(cache=True, error_model="numpy", nogil=True)
def write_path(costs, travel, came_by, row, col, weights, reach, left, low, side, path):
    """Write the way to a cell as points at most half a planning cell apart.

    Args:
        costs: shape (height, width), uint8.
        travel: see `search`.
        came_by: see `search`.
        row: row of the cell.
        col: its column.
        weights: see `step_weights`.
        reach: greatest number of cells that a straight line replaces.
        left: where the first column begins, map frame [m].
        low: where the first row begins [m].
        side: of a cell [m].
        path: shape (n, 2), float64, written, map frame [m]; what is longer is cut off.

    Returns:
        How many points there are.
    """
    corners = shorten(costs, weights, travel, walk_back(came_by, row, col), reach)
    path[0, 0], path[0, 1] = left + (corners[0, 1] + 0.5) * side, low + (corners[0, 0] + 0.5) * side
    count = 1
    for k in range(1, corners.shape[0]):
        x0, y0 = left + (corners[k - 1, 1] + 0.5) * side, low + (corners[k - 1, 0] + 0.5) * side
        dx, dy = (corners[k, 1] - corners[k - 1, 1]) * side, (corners[k, 0] - corners[k - 1, 0]) * side
        num_steps = math.ceil(2.0 * math.hypot(dx, dy) / side - 1e-9)
        for step in range(1, num_steps + 1):
            if count == path.shape[0]:
                return count
            path[count, 0], path[count, 1] = x0 + dx * step / num_steps, y0 + dy * step / num_steps
            count += 1
    return count


@njit(cache=True, error_model="numpy", nogil=True)
def plan_again(
    data, resolution, origin_x, origin_y, x, y, theta, points, goal_x, goal_y, tolerance, reach, tables, path
):
    """Plan the way to a goal on the map as it is now.

    Args:
        data: see `survey_map`.
        resolution: see `survey_map`.
        origin_x: see `survey_map`.
        origin_y: see `survey_map`.
        x: see `survey_map`.
        y: see `survey_map`.
        theta: see `survey_map`.
        points: see `survey_map`.
        goal_x: where to go, map frame [m].
        goal_y: the same [m].
        tolerance: how far beside the goal the way may end [m].
        reach: see `write_path`.
        tables: `SurveyTables`.
        path: see `write_path`.

    Returns:
        How many points the path has; 0 if there is no way.
    """
    _, costs, top, left, stand = survey_map(data, resolution, origin_x, origin_y, x, y, theta, points, tables)
    if stand[0] < 0:
        return 0
    side = tables.block * resolution
    goal_row, goal_col = math.floor((goal_y - origin_y) / side) - top, math.floor((goal_x - origin_x) / side) - left
    slack = math.floor(tolerance / side + 1e-9)
    goal = nearest_cell(costs, tables.weights, goal_row, goal_col, slack, COST_MAX_FREE)
    if goal[0] < 0:
        return 0
    travel, came_by = search(costs, tables.weights, stand[0], stand[1], goal[0], goal[1])
    if travel[goal[0] + 1, goal[1] + 1] == UNREACHED:
        return 0
    x0, y0 = origin_x + left * side, origin_y + top * side
    return write_path(costs, travel, came_by, goal[0], goal[1], tables.weights, reach, x0, y0, side, path)
