"""What a map offers: frontiers that the robot can get to, and the ways there. Kernels, and the tables they need."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.frontier_choice.params import SurveyParams
from envs.navigation.astar import UNREACHED, search, step_weights
from envs.navigation.costmap import COST_INSCRIBED, COST_MAX_FREE, CostmapParams, Inflation, inflate, known_window
from envs.navigation.frontiers import clear_around, count_unknown, flood, mark_frontier
from envs.navigation.obstacles import mark_missing, points_within
from envs.navigation.paths import nearest_cell, shorten, walk_back
from envs.navigation.viewpoints import cheapest_view
from envs.robots import RobotParams

OCCUPIED_FROM = 50
"""Least occupancy that is an obstacle [percent]."""
COST_WEIGHT = 3.0
"""How many times its length a step over the dearest free cell costs more than one over a free one."""

CANDIDATE_FIELDS = (
    "goal_row",
    "goal_col",
    "frontier_row",
    "frontier_col",
    "cost",
    "size",
    "gain",
    "clearance",
    "heading",
)
"""Columns of what `find_candidates` returns: where to stand and what to see from there [planning cells], the travel
cost [units of `search`], the frontier's length [cells], unknown cells around it, distance from the goal to the nearest
obstacle [cells], and the direction of the way there [rad]."""
GOAL_ROW, GOAL_COL, FRONTIER_ROW, FRONTIER_COL, COST, SIZE, GAIN, CLEARANCE, HEADING = range(len(CANDIDATE_FIELDS))


class SurveyTables(NamedTuple):
    """Robot and `SurveyParams` in planning cells, as Numba takes them."""

    block: int
    """Side of a planning cell [map cells]."""
    costs: np.ndarray
    """Shape (n,), uint8: cost by the squared distance to the nearest obstacle [cells2]."""
    weights: np.ndarray
    """Shape (256,), uint8, see `step_weights`."""
    inflation: int
    """Distance up to which nearness to an obstacle costs [cells]."""
    radius: int
    """How far from its cell the robot may be taken to stand [cells]."""
    same_obstacle: int
    """[cells]"""
    marking_range: float
    """[m]"""
    max_extent: int
    """[cells]"""
    views: tuple[int, ...]
    """View distances [cells]."""
    gain_radius: float
    """[cells]"""
    heading_steps: int
    """[cells]"""

    @classmethod
    def of(cls, params: SurveyParams, robot_radius: float, block: int, resolution: float) -> "SurveyTables":
        """Collect the numbers for a robot of a radius [m] on a map with cells of a side [m]."""
        side = block * resolution
        spread = CostmapParams(robot_radius, robot_radius + params.inflation, params.cost_scaling_factor, OCCUPIED_FROM)
        inflation = Inflation.of(spread, side)
        return cls(
            block=block,
            costs=inflation.cost_of_squared,
            weights=step_weights(COST_WEIGHT, False),
            inflation=inflation.reach,
            radius=max(1, math.floor(robot_radius / side + 1e-9)),
            same_obstacle=round(params.same_obstacle / side),
            marking_range=params.marking_range,
            max_extent=max(2, round(params.max_extent / side)),
            views=tuple(int(distance / side + 1e-9) for distance in params.view_distances),
            gain_radius=params.gain_radius / side,
            heading_steps=max(1, round(params.heading_distance / side)),
        )


def tables_of(params: SurveyParams, robot: RobotParams, resolution: float) -> tuple[SurveyTables, ...]:
    """Return the tables to try in turn: for the padded robot, then for smaller ones."""
    block = max(1, min(round(params.cell / resolution), int(robot.radius / resolution)))
    radii = robot.radius + params.padding, *(share * robot.radius for share in params.tight_radii)
    return tuple(SurveyTables.of(params, radius, block, resolution) for radius in radii)


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


@njit(cache=True, error_model="numpy")
def _split(cells, first, last, extent, bounds):
    """Split the cells from `first` to `last` - 1 in place, until no part's bounding box is longer than `extent`.

    Args:
        cells: shape (n, 2), int64, reordered.
        first: first cell.
        last: cell after the last.
        extent: [cells].
        bounds: shape (n + 1, 2), int64, written: first cell, and cell after the last, of each part.

    Returns:
        How many parts there are.
    """
    stack = [(first, last)]
    count = 0
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
def _clearance(joined, row, col, reach):
    """Return the distance from a cell to the nearest occupied one, at most `reach` [cells]."""
    height, width = joined.shape
    best = reach * reach
    for r in range(max(row - reach, 0), min(row + reach + 1, height)):
        for c in range(max(col - reach, 0), min(col + reach + 1, width)):
            if joined[r, c] >= OCCUPIED_FROM:
                best = min(best, (r - row) ** 2 + (c - col) ** 2)
    return math.sqrt(best)


@njit(cache=True, error_model="numpy")
def _describe(joined, came_by, travel, goal_row, goal_col, row, col, size, tables, candidate):
    """Write the row of a candidate; see `CANDIDATE_FIELDS`."""
    candidate[GOAL_ROW], candidate[GOAL_COL] = goal_row, goal_col
    candidate[FRONTIER_ROW], candidate[FRONTIER_COL] = row, col
    candidate[COST] = travel[goal_row + 1, goal_col + 1]
    candidate[SIZE] = size
    candidate[GAIN] = count_unknown(joined, row, col, tables.gain_radius)
    candidate[CLEARANCE] = _clearance(joined, goal_row, goal_col, tables.inflation)
    way = walk_back(came_by, goal_row, goal_col)
    # Standing on the goal already, the way on is the one to what is to be seen.
    ahead_row, ahead_col = row, col
    if way.shape[0] > 1:
        ahead = min(tables.heading_steps, way.shape[0] - 1)
        ahead_row, ahead_col = way[ahead, 0], way[ahead, 1]
    candidate[HEADING] = math.atan2(ahead_row - way[0, 0], ahead_col - way[0, 1])


@njit(cache=True, error_model="numpy")
def _gather(joined, travel, came_by, cells, starts, min_length, tables, bounds, found):
    """Write the candidates among frontiers of at least `min_length` cells to `found`, and return how many there are."""
    count = 0
    for k in range(len(starts) - 1):
        if starts[k + 1] - starts[k] < min_length:
            continue
        for part in range(_split(cells, starts[k], starts[k + 1], tables.max_extent, bounds)):
            members = cells[bounds[part, 0] : bounds[part, 1]]
            for reach in tables.views:
                row, col, seen = cheapest_view(joined, travel, members, reach)
                if seen >= 0:
                    place = members[seen]
                    _describe(joined, came_by, travel, row, col, place[0], place[1], len(members), tables, found[count])
                    count += 1
                    break
    return count


@njit(cache=True, error_model="numpy", nogil=True)
def find_candidates(
    data, resolution, origin_x, origin_y, x, y, theta, points, given_up, min_lengths, max_candidates, tables
):
    """Find frontiers that the robot can get to.

    Args:
        data: see `survey_map`.
        resolution: see `survey_map`.
        origin_x: see `survey_map`.
        origin_y: see `survey_map`.
        x: see `survey_map`.
        y: see `survey_map`.
        theta: see `survey_map`.
        points: see `survey_map`.
        given_up: shape (m, 2), float64, frontier cells that do not count any more, nor do their neighbours, map
            frame [m].
        min_lengths: cells that a frontier has at least; the next one counts where none of those before can be reached.
        max_candidates: how many are returned at most, the cheapest to get to.
        tables: `SurveyTables`.

    Returns:
        Candidates, shape (k, 9), float64, see `CANDIDATE_FIELDS`, by increasing travel cost; then what the ways there
        are read from: costs, travel costs and steps of `search`, and the first row and column [planning cells].
    """
    joined, costs, top, left, stand = survey_map(data, resolution, origin_x, origin_y, x, y, theta, points, tables)
    if stand[0] < 0:
        none = np.full((joined.shape[0] + 2, joined.shape[1] + 2), UNREACHED, dtype=np.int32)
        return np.empty((0, len(CANDIDATE_FIELDS))), costs, none, np.zeros(none.shape, dtype=np.uint8), top, left
    travel, came_by = search(costs, tables.weights, stand[0], stand[1], -1, -1)
    mask = mark_frontier(joined)
    side = tables.block * resolution
    clear_around(mask, cells_of(given_up, origin_x + left * side, origin_y + top * side, side))
    cells = np.empty((np.count_nonzero(mask), 2), dtype=np.int64)
    starts = flood(mask, cells)
    bounds = np.empty((len(cells) + 1, 2), dtype=np.int64)
    found = np.empty((len(cells) + 1, len(CANDIDATE_FIELDS)))
    num_found = 0
    for min_length in min_lengths:
        if num_found == 0:
            num_found = _gather(joined, travel, came_by, cells, starts, min_length, tables, bounds, found)
    order = np.argsort(found[:num_found, COST], kind="mergesort")[:max_candidates]
    return found[order], costs, travel, came_by, top, left


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
