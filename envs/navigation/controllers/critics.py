"""Critics of Nav2's local planner DWB: kernels that simulate twists and score the trajectories.

Rasters are square, in the base frame, with the robot in the middle and x along columns. `now`: current twist [m/s,
rad/s]. `numbers`: record with the fields of `DwbParams`.
"""

import math
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import wrap_angle
from lidarnaut.envs.geometry.rows import write_row
from lidarnaut.envs.navigation.maps.costmap import COST_INSCRIBED

ROTATE_TO_GOAL, OSCILLATION, BASE_OBSTACLE, GOAL_ALIGN, PATH_ALIGN, PATH_DIST, GOAL_DIST = range(7)
NUM_CRITICS = 7


class Rasters(NamedTuple):
    """Local costmap, with distances to obstacles, path and goal."""

    costs: np.ndarray
    """Traversal costs, shape (side, side), uint8, as in `Costmap`."""
    squared: np.ndarray
    """Squared obstacle distance, exact within the inflation radius, shape (side, side), uint16 [cells2]."""
    steps: np.ndarray
    """Distances from each cell to the path, the local goal on it, and a point beyond this goal, in 4-connected moves
    around obstacles, shape (3, side, side), int32."""


class Ending(NamedTuple):
    """State of the robot relative to the goal, for DWB's critics `RotateToGoal`, `GoalAlign` and `PathAlign`."""

    is_near: bool
    """True if the robot is within the goal tolerance. Always False for goals without a heading."""
    heading: float
    """Goal heading, base frame [rad]."""
    aligns: bool
    """True if the critic `PathAlign` is used: the goal is farther from the robot than `forward_point_distance`."""


@njit(cache=True, error_model="numpy")
def roll_out(v, w, now, numbers, poses):
    """Simulate a commanded twist with acceleration limits; return the number of poses.

    Writes `poses`, shape (n, 3): x, y, heading after each step, base frame [m, m, rad].
    """
    speed, rate = now
    turns = max(abs(w), abs(rate)) * numbers.sim_time / numbers.angular_granularity
    metres = max(abs(v), abs(speed)) * numbers.sim_time / numbers.linear_granularity
    num_steps = min(max(1, math.ceil(max(turns, metres))), poses.shape[0])
    dt, turn = numbers.sim_time / num_steps, math.nan
    x = y = theta = 0.0
    c = s = step_c = step_s = 0.0
    for k in range(num_steps):
        speed += min(max(v - speed, -numbers.acc_lim_x * dt), numbers.acc_lim_x * dt)
        rate += min(max(w - rate, -numbers.acc_lim_theta * dt), numbers.acc_lim_theta * dt)
        if rate * dt == turn:
            c, s = c * step_c - s * step_s, s * step_c + c * step_s
        else:
            turn = rate * dt
            c, s = math.cos(theta + 0.5 * turn), math.sin(theta + 0.5 * turn)
            step_c, step_s = math.cos(turn), math.sin(turn)
        x += speed * dt * c
        y += speed * dt * s
        theta += turn
        poses[k, 0], poses[k, 1], poses[k, 2] = x, y, theta
    return num_steps


@njit(cache=True, error_model="numpy")
def spread(costs, distances, seeds):
    """Compute the number of 4-connected moves from each cell to the nearest target cell, around obstacles.

    Writes `distances`, shape (n, n), int32: n * n for cells in collision, n * n + 1 for unreachable cells. `seeds`:
    distinct flat indices of the target cells.
    """
    side = costs.shape[0]
    size = side * side
    flat, steps = costs.reshape(size), distances.reshape(size)
    queue = np.empty(size, dtype=np.int64)
    first, last = 0, len(seeds)
    write_row(queue, seeds)
    steps[:] = size + 1
    steps[queue[:last]] = 0
    while first < last:
        cell = queue[first]
        first += 1
        row, col = cell // side, cell % side
        for d_row, d_col in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            if row + d_row < 0 or col + d_col < 0 or row + d_row >= side or col + d_col >= side:
                continue
            neighbour = cell + d_row * side + d_col
            if steps[neighbour] != size + 1:
                continue
            if flat[neighbour] >= COST_INSCRIBED:
                steps[neighbour] = size
                continue
            steps[neighbour] = steps[cell] + 1
            queue[last] = neighbour
            last += 1


@njit(cache=True, error_model="numpy", inline="always")
def cell_of(x, y, side, resolution):
    """Return the flat cell index of (x, y), base frame [m]; -1 outside the raster."""
    half = 0.5 * side
    col, row = math.floor(x / resolution + half), math.floor(y / resolution + half)
    return row * side + col if 0 <= row < side and 0 <= col < side else -1


@njit(cache=True, error_model="numpy")
def _rotate_to_goal(v, poses, num_steps, now, numbers, ending):
    if not ending.is_near:
        return 0.0
    error = abs(wrap_angle(poses[num_steps - 1, 2] - ending.heading))
    if abs(now[0]) > numbers.trans_stopped_velocity:
        return v * v * numbers.slowing_factor + error if abs(v) < abs(now[0]) else np.nan
    return error if v == 0.0 else np.nan


@njit(cache=True, error_model="numpy")
def meets_people(poses, num_steps, people, sim_time, radius):
    """Return True if the robot would touch people on a simulated trajectory. People keep their velocity.

    `people`: position, velocity and radius, shape (n, 5), base frame. `sim_time`: trajectory duration [s]. `radius`:
    footprint radius [m].
    """
    for i in range(people.shape[0]):
        x, y, v_x, v_y, r = people[i]
        now = math.hypot(x, y)
        for k in range(num_steps):
            time = sim_time * (k + 1) / num_steps
            away = math.hypot(x + time * v_x - poses[k, 0], y + time * v_y - poses[k, 1])
            if away < r + radius and away < now:
                return True
    return False


@njit(cache=True, error_model="numpy")
def _clearance_cost(poses, num_steps, rasters, resolution):
    side = rasters.costs.shape[0]
    cost_of, squared_of = rasters.costs.reshape(side * side), rasters.squared.reshape(side * side)
    middle = (side // 2) * side + side // 2
    touches = cost_of[middle] >= COST_INSCRIBED
    cost = np.uint8(0)
    for k in range(num_steps):
        cell = cell_of(poses[k, 0], poses[k, 1], side, resolution)
        if cell < 0:
            return np.nan
        cost = cost_of[cell]
        if cost >= COST_INSCRIBED and not (touches and squared_of[cell] >= squared_of[middle]):
            return np.nan
    return float(cost)


@njit(cache=True, error_model="numpy")
def _steps_at(distances, x, y, resolution, must_lead):
    side = distances.shape[0]
    size = side * side
    cell = cell_of(x, y, side, resolution)
    steps = size + 1 if cell < 0 else distances.reshape(size)[cell]
    return np.nan if must_lead and steps >= size else float(steps)


@njit(cache=True, error_model="numpy")
def judge(twists, banned, now, numbers, ending, rasters, people, radius, scores):
    """Score velocity commands (twists) by seven critics; lower is better, NaN rejects a twist.

    `twists`: shape (n, 2) [m/s, rad/s]. `banned`: flags that reject v < 0, v > 0, w < 0, w > 0, against oscillation.
    `people`, `radius`: see `meets_people`. Writes `scores`, shape (n, 7): columns from `ROTATE_TO_GOAL` to `GOAL_DIST`.
    """
    poses = np.empty((1000, 3))
    to_path, to_goal, to_goal_ahead = rasters.steps[0], rasters.steps[1], rasters.steps[2]
    resolution, ahead = numbers.resolution, numbers.forward_point_distance
    for i in range(twists.shape[0]):
        v, w = twists[i]
        scores[i] = np.nan
        if (v < 0 and banned[0]) or (v > 0 and banned[1]) or (w < 0 and banned[2]) or (w > 0 and banned[3]):
            continue
        num_steps = roll_out(v, w, now, numbers, poses)
        cost = _clearance_cost(poses, num_steps, rasters, resolution)
        if math.isnan(cost) or meets_people(poses, num_steps, people, numbers.sim_time, radius):
            continue
        x, y, theta = poses[num_steps - 1]
        front_x, front_y = x + ahead * math.cos(theta), y + ahead * math.sin(theta)
        scores[i, ROTATE_TO_GOAL] = _rotate_to_goal(v, poses, num_steps, now, numbers, ending)
        scores[i, OSCILLATION] = 0.0
        scores[i, BASE_OBSTACLE] = cost
        # Unlike in Nav2, the final turn is not biased towards the goal.
        aligned = 0.0 if ending.is_near else _steps_at(to_goal_ahead, front_x, front_y, resolution, False)
        scores[i, GOAL_ALIGN] = aligned
        scores[i, PATH_ALIGN] = _steps_at(to_path, front_x, front_y, resolution, False) if ending.aligns else 0.0
        scores[i, PATH_DIST] = _steps_at(to_path, x, y, resolution, True)
        scores[i, GOAL_DIST] = _steps_at(to_goal, x, y, resolution, True)
