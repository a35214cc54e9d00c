"""Viewpoints of frontier points: one kernel for all, because a large world may have hundreds of them."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from baselines.rrt.params import RrtParams
from baselines.survey import Survey
from envs.navigation import COST_MAX_FREE, COST_UNKNOWN, cheapest_view

NO_GOAL = -1
"""In place of a row and a column, for a point that is invalid or cannot be reached."""


class OpenGoals(NamedTuple):
    """Viewpoints that can be reached, and the frontiers to see from them."""

    viewpoints: np.ndarray
    """Shape (n, 2), int64, cells (row, column)."""
    frontiers: np.ndarray
    """Shape (n, 2), float64, map frame [m]."""


def ros_costs() -> np.ndarray:
    """Tabulate a costmap's costs on the scale on which ROS publishes costmaps: shape (256,), float64.

    1 to 98 near obstacles, 99 where the footprint touches one and beyond; 0 where it is free or unknown.
    """
    costs = np.arange(256)
    table = np.where(costs > 0, 1.0 + np.floor(97.0 * (costs - 1) / 251.0), 0.0)
    table[costs > COST_MAX_FREE] = 99.0
    table[COST_UNKNOWN] = 0.0
    return table


_ROS_COSTS = ros_costs()


@njit(cache=True, error_model="numpy")
def _nearest_marked(mask, x, y, radius):
    """Return row and column of the marked cell whose centre is nearest to a point, the first of equals.

    Args:
        mask: shape (height, width), bool.
        x: column of the point as a real number: cell c holds [c, c + 1).
        y: row of the point.
        radius: how far away the centre may be [cells].

    Returns:
        Row and column; `NO_GOAL` twice if there is none.
    """
    height, width = mask.shape
    best, best_row, best_col = radius * radius, NO_GOAL, NO_GOAL
    for row in range(max(math.ceil(y - radius - 0.5), 0), min(math.floor(y + radius - 0.5) + 1, height)):
        for col in range(max(math.ceil(x - radius - 0.5), 0), min(math.floor(x + radius - 0.5) + 1, width)):
            squared = (col + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2
            if mask[row, col] and (squared < best or (best_row < 0 and squared <= best)):
                best, best_row, best_col = squared, row, col
    return best_row, best_col


@njit(cache=True, error_model="numpy")
def _goals(data, costs, travel, frontier, points, ros_costs, max_cost, radius, reaches):
    """Find the goals of points.

    Args:
        data: shape (height, width), int8, occupancy.
        costs: same shape, uint8, of the costmap.
        travel: shape (height + 2, width + 2), int32, with a border of one cell.
        frontier: shape (height, width), bool.
        points: shape (n, 2), float64, (column, row).
        ros_costs: shape (256,), float64, see `ros_costs`.
        max_cost: greatest of these at a point.
        radius: distance up to which a frontier cell belongs to a point [cells].
        reaches: shape (k,), int64, distances from which a cell may be seen [cells], tried in their order.

    Returns:
        Shape (n, 4), int64: row and column of the viewpoint, row and column of the frontier cell; `NO_GOAL` where a
        point has none.
    """
    height, width = data.shape
    goals = np.full((len(points), 4), NO_GOAL, dtype=np.int64)
    target = np.empty((1, 2), dtype=np.int64)
    for k in range(len(points)):
        row, col = math.floor(points[k, 1]), math.floor(points[k, 0])
        inside = 0 <= row < height and 0 <= col < width
        if inside and ros_costs[costs[row, col]] > max_cost:
            continue
        target[0] = _nearest_marked(frontier, points[k, 0], points[k, 1], radius)
        if target[0, 0] < 0:
            continue
        for reach in reaches:
            view_row, view_col, seen = cheapest_view(data, travel, target, reach)
            if seen >= 0:
                goals[k, 0], goals[k, 1] = view_row, view_col
                goals[k, 2], goals[k, 3] = target[0]
                break
    return goals


def goals_of(survey: Survey, points: np.ndarray, params: RrtParams) -> OpenGoals:
    """Return a viewpoint for each frontier point that is valid and that the robot can get near to, in their order.

    Args:
        survey: the map; its field must not be None.
        points: shape (n, 2), float64, map frame [m].
        params: `max_cost` beyond which a point is invalid, `bandwidth` up to which a frontier cell belongs to a point,
            and `view_distances`.
    """
    assert survey.field is not None
    grid = survey.grid
    found = _goals(
        grid.data,
        survey.costmap.costs,
        survey.field.travel,
        survey.frontier,
        (points - grid.origin) / grid.resolution,
        _ROS_COSTS,
        params.max_cost,
        params.bandwidth / grid.resolution,
        np.array([int(distance / grid.resolution + 1e-9) for distance in params.view_distances]),
    )
    found = found[found[:, 0] != NO_GOAL]
    return OpenGoals(found[:, :2], grid.centers(found[:, 2:]))
