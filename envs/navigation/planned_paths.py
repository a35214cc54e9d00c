"""Paths over planning cells, written as points. Kernels.

`costs`: shape (height, width), uint8; `weights`: see `step_weights`; `expansion` and `entries`: workspace, see `begin`.
Cells are (row, column).
"""

import math

import numpy as np
from numba import njit

from envs.navigation.astar import UNREACHED, begin, expand, octile
from envs.navigation.costmap import COST_INSCRIBED, COST_LETHAL, COST_MAX_FREE
from envs.navigation.paths import nearest_cell, shorten, walk_back


@njit(cache=True, error_model="numpy")
def write_path(costs, weights, expansion, cell, reach, frame, path):
    """Write the path to a cell that a search has reached as points at most half a planning cell apart.

    A straight line replaces at most `reach` cells. `frame` is where the first column and the first row begin, map frame
    [m], and the side of a cell [m]. `path`, shape (n, 2), float64, is written, map frame [m]; what is longer is cut
    off. Returns how many points there are.
    """
    left, low, side = frame
    shape = (costs.shape[0] + 2, costs.shape[1] + 2)
    travel, predecessor = expansion.travel.reshape(shape), expansion.predecessor.reshape(shape)
    corners = shorten(costs, weights, travel, walk_back(predecessor, cell[0], cell[1]), reach)
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


@njit(cache=True, error_model="numpy")
def search_goal(layer, weights, expansion, entries, start, goal, slack):
    """Search for the cheapest path to a goal; what the search costs grows with what lies between, and not with the map.

    `layer` holds `costs` and the `open_weights` of `_expand`. The path may end up to `slack` cells beside the goal.
    Returns the cell where it ends, (-1, -1) without one; and `entries`.
    """
    costs, open_weights = layer
    row, col = nearest_cell(costs, weights, goal[0], goal[1], slack, COST_MAX_FREE)
    if row < 0:
        return (-1, -1), entries
    stride, touching = np.uint32(costs.shape[1] + 2), np.uint8(weights[COST_INSCRIBED])
    level = octile(row - start[0], col - start[1])
    begin(expansion, entries, stride, start[0], start[1], costs[start[0], start[1]] == COST_LETHAL, level)
    entries = expand(expansion, entries, open_weights, stride, touching, (row, col), np.int64(UNREACHED))
    if expansion.travel[(row + 1) * np.int64(stride) + col + 1] == UNREACHED:
        return (-1, -1), entries
    return (row, col), entries
