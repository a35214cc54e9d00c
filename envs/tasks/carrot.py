import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.files import resolve
from lidarnaut.envs.geometry.pose import distance
from lidarnaut.envs.navigation.planners import GoalPlanner
from lidarnaut.envs.observations.plan import look_ahead
from lidarnaut.envs.observations.positions import GOAL_MEMORY, TaskPart
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robot_rows import RobotRows
from lidarnaut.envs.task import ObservationPart, RowPart

from . import reach_kernels as own_at

AHEAD = 0.8
"""Lookahead distance [m]."""
MAX_DESCENT = 6.0
"""Length of the shortest path ahead of the robot that is searched for the farthest visible point [m]."""


@njit(cache=True, error_model="numpy")
def find_carrot(own, x, y, lengths, ahead):
    """Return a lookahead point (x, y) for driving along the shortest path to the goal, world frame [m].

    The point lies `ahead` [m] from the robot at (x, y), towards the farthest visible point of the path. `own`: state
    array of the task; `lengths`: raster of geodesic distances to the goal [m].
    """
    if own[own_at.LEFT] <= ahead:
        return own[own_at.TRUE_X], own[own_at.TRUE_Y]
    left, low, side = own[own_at.FIELD_X], own[own_at.FIELD_Y], own[own_at.FIELD_SIDE]
    row, col, driven, at_x, at_y = math.floor((y - low) / side), math.floor((x - left) / side), 0.0, x, y
    found_x, found_y = own[own_at.TRUE_X], own[own_at.TRUE_Y]
    while driven < max(MAX_DESCENT, ahead) and driven < own[own_at.LEFT]:
        best, best_row, best_col = np.inf, row, col
        for i in range(max(row - 1, 0), min(row + 2, lengths.shape[0])):
            for j in range(max(col - 1, 0), min(col + 2, lengths.shape[1])):
                # If the robot is outside free space, include the way back.
                total = lengths[i, j] + distance(left + (j + 0.5) * side - at_x, low + (i + 0.5) * side - at_y)
                if (i != row or j != col) and total < best:
                    best, best_row, best_col = total, i, j
        if best_row == row and best_col == col:
            break
        row, col = best_row, best_col
        to_x, to_y = left + (col + 0.5) * side, low + (row + 0.5) * side
        driven += distance(to_x - at_x, to_y - at_y)
        if driven > ahead and not _is_free((x - left) / side, (y - low) / side, col + 0.5, row + 0.5, lengths):
            break
        at_x, at_y = found_x, found_y = to_x, to_y
    share = min(ahead / max(distance(found_x - x, found_y - y), 1e-9), 1.0)
    return x + share * (found_x - x), y + share * (found_y - y)


@njit(cache=True, error_model="numpy", inline="always")
def _is_free(x, y, to_x, to_y, lengths):
    count = int(2.0 * max(abs(to_x - x), abs(to_y - y))) + 1
    for k in range(1, count + 1):
        if not lengths[int(y + (to_y - y) * k / count), int(x + (to_x - x) * k / count)] < np.inf:
            return False
    return True


@njit(cache=True, error_model="numpy")
def write_carrots(rows, owns, lengths, ahead, active, out):
    """Write observations of lookahead points on shortest paths, for several environments.

    Values: cosine and sine of the direction; path length to the goal divided by `ahead` [m], at most 1. `active`: mask
    of environments; `out`: shape (n, 3), float32.
    """
    for k in range(rows.shape[0]):
        if active[k]:
            x, y = find_carrot(owns[k], rows[k].x, rows[k].y, lengths[k], ahead)
            angle = math.atan2(y - rows[k].y, x - rows[k].x) - rows[k].theta
            out[k, 0], out[k, 1], out[k, 2] = math.cos(angle), math.sin(angle), min(owns[k, own_at.LEFT] / ahead, 1.0)


class PlannedCarrot(TaskPart):
    """Observation of the direction to a lookahead point on the planned path.

    Values: cosine and sine of the direction, robot frame; remaining path length divided by lookahead distance, at most
    1. Before the first plan, the path is the straight line to the goal.
    """

    size = 3

    def write(self, robot: Robot, out: np.ndarray) -> None:
        planner = robot.planner("goal", partial(GoalPlanner, robot.params, robot.control_period))
        pose = robot.belief.pose
        tolerances = self._task.goal_tolerance, self._task.heading_tolerance
        path = planner.update(robot.reading, robot.belief, self._task.tell_goal(pose), tolerances)
        planner.nearest = look_ahead(path, planner.nearest, tuple(pose), (AHEAD,), out)
        rest = np.vstack([pose[:2], path[planner.nearest :]])
        out[2] = min(float(np.hypot(*np.diff(rest, axis=0).T).sum()) / AHEAD, 1.0)


class ShortestCarrot(RowPart):
    """Observation of a lookahead point on the true shortest path around static obstacles, for training."""

    size, uses_ground_truth = 3, True

    def __init__(self, task: Any) -> None:
        self._task = task

    def _write(self, rows: RobotRows, out: np.ndarray) -> None:
        lengths = self._task.arrays if rows.task_arrays is None else rows.task_arrays[0]
        write_carrots(rows.numbers, rows.memory[GOAL_MEMORY], lengths, AHEAD, rows.active, out)


CARROTS: dict[str, Callable[..., ObservationPart]] = {"plan": PlannedCarrot, "shortest": ShortestCarrot}
"""Classes of lookahead observations by source of the path."""


def make_carrot(task: Any, path: str = "plan") -> ObservationPart:
    """Create the observation of a lookahead point on the planned ("plan") or the true shortest path ("shortest")."""
    return resolve(path, CARROTS, "path of carrot")(task)
