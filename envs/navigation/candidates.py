"""Frontier candidates: frontiers that the robot can get to, each with the viewpoint that is cheapest to get to.

The search for paths expands from the robot, and stops when the cheapest candidates are known: what lies beyond them
costs nothing. Kernels.
"""

import numpy as np
from numba import njit

from envs.navigation.astar import NUM_WAITING, SCALE, STRAIGHT, UNREACHED, begin, expand
from envs.navigation.costmap import COST_INSCRIBED, COST_LETHAL
from envs.navigation.viewpoints import cheapest_view

FOUND = np.dtype(
    [
        ("goal", np.int64, 2),  # row and column of the viewpoint
        ("frontier", np.int64, 2),  # row and column of the frontier cell that is seen from there
        ("cost", np.int64),  # travel cost [units of `search`]
        ("size", np.int64),  # number of frontier cells
        ("part", np.int64),  # index of the part of `split_groups`
    ]
)
"""A candidate in planning cells."""


@njit(cache=True, error_model="numpy")
def _view(joined, travel, members, tables, limit, is_complete):
    """Find the cheapest viewpoint of frontier cells, at the least view distance from which there is one.

    Returns row, column, index of the cell in view, travel cost; the index is -1 where the search has not come far
    enough, or -2 where there is none.
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
        Candidates, shape (k,), `FOUND`, by increasing travel cost; and `entries`.
    """
    costs, open_weights = layer
    cells, parts = frontier
    height, width = joined.shape
    travel = expansion.travel.reshape(height + 2, width + 2)
    stride, touching = np.uint32(width + 2), np.uint8(tables.weights[COST_INSCRIBED])
    begin(expansion, entries, stride, start[0], start[1], costs[start[0], start[1]] == COST_LETHAL, 0)
    found = np.empty(len(parts), dtype=FOUND)
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
                    new = found[num_found]
                    new.goal[0], new.goal[1] = row, col
                    new.frontier[0], new.frontier[1] = members[seen]
                    new.cost, new.size, new.part = cost, len(members), k
                    num_found += 1
                    is_settled[k] = True
            for k in range(num_found):
                num_sure += found[k].cost <= limit - tables.detour
            if num_sure >= max_candidates:
                break
            limit *= 2
        if num_found > 0:
            break
    # Parts found in a later round may cost less than some before: a view from afar waits for a nearer one.
    order = np.argsort(found["cost"][:num_found], kind="mergesort")[:max_candidates]
    return found[order], entries
