"""Candidates: frontiers that the robot can get to, each with the place from which it is seen at least cost."""

import math

import numpy as np
from numba import njit

from envs.frontier_choice.survey import cells_of, survey_map
from envs.frontier_choice.tables import OCCUPIED_FROM
from envs.navigation.astar import UNREACHED, search
from envs.navigation.frontiers import clear_around, count_unknown, flood, mark_frontier
from envs.navigation.paths import walk_back
from envs.navigation.viewpoints import cheapest_view

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
