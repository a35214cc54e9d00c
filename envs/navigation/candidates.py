"""Frontier candidates: frontiers that the robot can get to, each with the viewpoint that is cheapest to get to.

The search for paths expands from the robot, and stops when the cheapest candidates are known: what lies beyond them
costs nothing. Kernels.
"""

import math

import numpy as np
from numba import njit

from envs.navigation.astar import NUM_WAITING, SCALE, STRAIGHT, UNREACHED, begin, expand
from envs.navigation.costmap import COST_INSCRIBED, COST_LETHAL
from envs.navigation.frontiers import count_unknown
from envs.navigation.paths import walk_back
from envs.navigation.planning_kernels import OCCUPIED_FROM
from envs.navigation.viewpoints import cheapest_view

CANDIDATE_FIELDS = ("goal_row", "goal_col", "frontier_row", "frontier_col", "cost", "size", "part")
"""Columns of what `find_candidates` returns: the viewpoint and the frontier cell that is seen from there [planning
cells], the travel cost [units of `search`], the frontier's length [cells], and which part it is."""
GOAL_ROW, GOAL_COL, FRONTIER_ROW, FRONTIER_COL, COST, SIZE, PART = range(len(CANDIDATE_FIELDS))


@njit(cache=True, error_model="numpy")
def _split(cells, first, last, extent, bounds, count):
    """Split the cells from `first` to `last` - 1 in place, until no part's bounding box is longer than `extent`.

    Args:
        cells: shape (n, 2), int64, reordered.
        first: first cell.
        last: cell after the last.
        extent: [cells].
        bounds: shape (n + 1, 2), int64, written from row `count` on: first cell, and cell after the last, of each part.
        count: number of parts before.

    Returns:
        How many parts there are now.
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
    """Split groups of frontier cells into parts that are no longer than `extent`.

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
def _view(joined, travel, members, tables, limit, is_complete):
    """Find the cheapest viewpoint of frontier cells, at the least view distance from which there is one.

    Returns:
        Row, column, index of the cell in view, travel cost; the index is -1 where the search has not come far enough,
        or -2 where there is none.
    """
    for k in range(len(tables.views)):
        row, col, seen = cheapest_view(joined, travel, members, tables.views[k])
        if seen < 0:
            continue
        cost = travel[row + 1, col + 1]
        needed = cost if k == 0 else cost + tables.detour
        if is_complete or needed <= limit:
            return row, col, seen, cost
        return row, col, -1, cost
    return -1, -1, -2 if is_complete else -1, UNREACHED


@njit(cache=True, error_model="numpy")
def _is_beyond(members, start, reach, limit):
    """Tell whether no cell within `reach` cells of any of some cells can be reached at a cost of `limit`."""
    nearest = np.int64(1 << 40)
    for k in range(len(members)):
        nearest = min(nearest, max(abs(members[k, 0] - start[0]), abs(members[k, 1] - start[1])))
    return (nearest - reach) * STRAIGHT * SCALE > limit


@njit(cache=True, error_model="numpy")
def find_candidates(joined, layer, expansion, entries, start, frontier, min_lengths, max_candidates, tables):
    """Find the frontiers that are cheapest to get to.

    Args:
        joined: shape (height, width), int8, occupancy of the planning cells.
        layer: costs, shape (height, width), uint8, and `open_weights` of `expand`.
        expansion: workspace, see `begin`.
        entries: workspace, see `begin`.
        start: (row, column) of the robot.
        frontier: cells (shape (n, 2), int64) and parts (shape (m, 4), int64) of `split_groups`.
        min_lengths: cells that a frontier has at least; the next one counts where none of those before can be reached.
        max_candidates: how many are returned at most.
        tables: `PlanningTables`.

    Returns:
        Candidates, shape (k, 7), float64, see `CANDIDATE_FIELDS`, by increasing travel cost; and `entries`.
    """
    costs, open_weights = layer
    cells, parts = frontier
    height, width = joined.shape
    travel = expansion.travel.reshape(height + 2, width + 2)
    stride, touching = np.uint32(width + 2), np.uint8(tables.weights[COST_INSCRIBED])
    begin(expansion, entries, stride, start[0], start[1], costs[start[0], start[1]] == COST_LETHAL, 0)
    found = np.empty((len(parts), len(CANDIDATE_FIELDS)))
    is_settled = np.zeros(len(parts), dtype=np.bool_)
    num_found = 0
    limit = tables.first_limit
    for min_length in min_lengths:
        is_complete = False
        while True:
            num_open = 0
            for k in range(len(parts)):
                if parts[k, 2] >= min_length and not is_settled[k]:
                    num_open += 1
            if num_open == 0 or is_complete:
                break
            entries = expand(expansion, entries, open_weights, stride, touching, (-1, -1), limit)
            is_complete = expansion.counters[NUM_WAITING] == 0
            num_sure = 0
            for k in range(len(parts)):
                if parts[k, 2] < min_length or is_settled[k]:
                    continue
                members = cells[parts[k, 0] : parts[k, 1]]
                if not is_complete and _is_beyond(members, start, tables.views[-1], limit):
                    continue
                row, col, seen, cost = _view(joined, travel, members, tables, limit, is_complete)
                if seen >= 0:
                    found[num_found, GOAL_ROW], found[num_found, GOAL_COL] = row, col
                    found[num_found, FRONTIER_ROW], found[num_found, FRONTIER_COL] = members[seen, 0], members[seen, 1]
                    found[num_found, COST], found[num_found, SIZE], found[num_found, PART] = cost, len(members), k
                    num_found += 1
                    is_settled[k] = True
            for k in range(num_found):
                num_sure += found[k, COST] <= limit - tables.detour
            if num_sure >= max_candidates:
                break
            limit *= 2
        if num_found > 0:
            break
    # Parts found in a later round may cost less than some before: a view from afar waits for a nearer one.
    order = np.argsort(found[:num_found, COST], kind="mergesort")[:max_candidates]
    return found[order], entries


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
def describe_surroundings(joined, predecessor, found, tables):
    """Describe where candidates lie.

    Args:
        joined: shape (height, width), int8, occupancy.
        predecessor: shape (height + 2, width + 2), uint8, of the search that found them.
        found: shape (k, 7), float64, see `CANDIDATE_FIELDS`.
        tables: `PlanningTables`.

    Returns:
        Shape (k, 3), float64: unknown cells around the frontier, distance from the viewpoint to the nearest obstacle
        [cells], and the direction of the path there [rad].
    """
    described = np.empty((len(found), 3))
    for k in range(len(found)):
        row, col = int(found[k, FRONTIER_ROW]), int(found[k, FRONTIER_COL])
        goal_row, goal_col = int(found[k, GOAL_ROW]), int(found[k, GOAL_COL])
        described[k, 0] = count_unknown(joined, row, col, tables.gain_radius)
        described[k, 1] = _clearance(joined, goal_row, goal_col, tables.inflation)
        path = walk_back(predecessor, goal_row, goal_col)
        # On the viewpoint already, the path on is the one to what is to be seen.
        if path.shape[0] > 1:
            ahead = min(tables.heading_steps, path.shape[0] - 1)
            row, col = path[ahead, 0], path[ahead, 1]
        described[k, 2] = math.atan2(row - path[0, 0], col - path[0, 1])
    return described
