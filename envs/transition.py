"""Numba kernels of control periods: contacts, statistics, predicted poses, and several periods of a drive."""

import math
from typing import Any

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation.trail import TRAIL_SPACING
from lidarnaut.envs.geometry.lookup import as_tuple
from lidarnaut.envs.geometry.pose import between, compose, distance
from lidarnaut.envs.geometry.rows import write_row
from lidarnaut.envs.navigation.controllers.navigator_kernels import (
    DRIVING,
    check_progress,
    compute_velocity_command,
    update_obstacles,
)
from lidarnaut.envs.robot import MAX_PERSON_GAP, MAX_TIME_TO_COLLISION, ONE_ACTIVE, REMEMBER, REMEMBER_TRUE, SCAN
from lidarnaut.envs.simulation.contact import drove_into
from lidarnaut.envs.simulation.crowd import person_row as crowd_at
from lidarnaut.envs.simulation.kinematic import step_robots
from lidarnaut.envs.simulation.records import TOUCHED_PERSON, MotionSettings
from lidarnaut.envs.slam.key_scans import has_moved

NUM_MOTION_SETTINGS = len(MotionSettings._fields)
PERSONAL_SPACE = 0.45
"""Gap between footprint and person that bounds personal space [m]: intimate distance of Hall, "The Hidden Dimension"
(1966)."""
UNCHECKED = -1
"""Returned by `drive` if arrival and stall were not checked in the last control period."""
BY_NOBODY, BY_ROBOT_ALONE, BY_ROBOT, BY_PERSON = range(4)
"""Causes of a contact: none; obstacle or other robot; robot drove into a person; person walked into the robot."""


@njit(cache=True, error_model="numpy")
def _is_apart(trail, x, y):
    dx, dy = x - trail[0], y - trail[1]
    return dx * dx + dy * dy >= TRAIL_SPACING * TRAIL_SPACING


@njit(cache=True, error_model="numpy")
def _watch_people(row, people):
    x, y, radius, period = row.x, row.y, row.radius, row.period
    vx, vy = (x - row.last_pose[0]) / period, (y - row.last_pose[1]) / period
    gap, time = MAX_PERSON_GAP, MAX_TIME_TO_COLLISION
    for i in range(people.shape[0]):
        dx, dy = people[i, crowd_at.X] - x, people[i, crowd_at.Y] - y
        reach, away = radius + people[i, crowd_at.RADIUS], distance(dx, dy)
        gap = min(gap, away - reach)
        wx, wy = people[i, crowd_at.VX] - vx, people[i, crowd_at.VY] - vy
        # |d + t w| = reach
        speed2, closing, rest = wx * wx + wy * wy, -(dx * wx + dy * wy), away * away - reach * reach
        root = closing * closing - speed2 * rest
        if closing > 0.0 and root >= 0.0:
            time = min(time, max(closing - math.sqrt(root), 0.0) / speed2)
    row.person_gap, row.least_gap = gap, min(row.least_gap, max(gap, 0.0))
    row.least_time = min(row.least_time, time)
    row.intrusion += period * (gap < PERSONAL_SPACE)
    row.touched_by = BY_NOBODY
    if row.touched > 0.0:
        person = int(row.touched) - TOUCHED_PERSON
        row.touched_by = BY_ROBOT_ALONE
        if person >= 0:
            row.touched_by = BY_ROBOT if drove_into(row, people[person]) else BY_PERSON
        if not row.last_touched > 0.0:
            row.hits[int(row.touched_by) - BY_ROBOT_ALONE] += 1.0


@njit(cache=True, error_model="numpy")
def store_actions(rows, actions, limits):
    """Store actions, fractions of the `limits` [m/s, rad/s], shape (n, 2); return twists, shape (n, 2), float64."""
    twists = np.empty((rows.shape[0], 2))
    for k in range(rows.shape[0]):
        row = rows[k]
        row.action_v, row.action_w = actions[k, 0], actions[k, 1]
        twists[k, 0], twists[k, 1] = row.action_v * limits[0], row.action_w * limits[1]
    return twists


@njit(cache=True, error_model="numpy")
def update_robots(rows, people):
    """Update robot states after a control period: contacts, predicted pose, and flags such as `SCAN`.

    The predicted pose follows odometry from the last processed scan. `rows`: records of robots.
    `people`: states of people.
    """
    for k in range(rows.shape[0]):
        row = rows[k]
        setup = MotionSettings(*as_tuple(row.motion_settings, NUM_MOTION_SETTINGS))
        before, now, x, y = as_tuple(row.last_pose, 3), (row.x, row.y, row.theta), row.x, row.y
        _watch_people(row, people)
        row.collisions += row.touched > 0.0 and not row.last_touched > 0.0
        row.path_length += distance(x - before[0], y - before[1])
        motion = as_tuple(row.odometry, 3)
        if row.touched > 0.0:
            row.slip += distance(motion[0], motion[1])
        row.twist[0], row.twist[1] = motion[0] / row.period, motion[2] / row.period
        acceleration = (row.commanded_v - row.last_v) / row.period
        row.jerk = abs(acceleration - row.acceleration) / row.period
        row.last_v, row.acceleration = row.commanded_v, acceleration
        if setup.uses_truth > 0.0:
            motion = between(before[0], before[1], before[2], now[0], now[1], now[2])
        write_row(row.motion, motion)
        pose, last = as_tuple(row.pose, 3), as_tuple(row.key_pose, 3)
        pose = compose(pose[0], pose[1], pose[2], motion[0], motion[1], motion[2])
        write_row(row.pose, pose)
        row.pending = 0
        travel, turn = setup.min_travel_distance, setup.min_travel_angle
        if has_moved(last[0], last[1], last[2], pose[0], pose[1], pose[2], travel, turn):
            row.pending = SCAN
        elif _is_apart(row.trail, pose[0], pose[1]):
            row.pending = REMEMBER
        if _is_apart(row.true_trail, x, y):
            row.pending += REMEMBER_TRUE
        write_row(row.last_pose, now)
        row.last_touched = row.touched


@njit(cache=True, error_model="numpy")
def step_rows(rows, draws, ranges, active, num_robots, world_arrays):
    """Simulate one control period of several environments with `num_robots` robots each.

    `rows`, `draws`, `ranges`: states, random numbers and lidar ranges of robots, one row per robot. `active`:
    environments to simulate, shape (num_envs,), bool. `world_arrays`: wall segments, circles, magnets and people by
    environment.
    """
    for i in range(active.shape[0]):
        if active[i]:
            first, last = i * num_robots, (i + 1) * num_robots
            own, (segments, circles, magnets, crowd) = rows[first:last], world_arrays[i]
            step_robots(own, draws[first:last], ranges[first:last], segments, circles, magnets, crowd)
            update_robots(own, crowd[0])


@njit(cache=True, error_model="numpy")
def record_positions(rows, active, positions, counts):
    """Append the positions of robots with a flag `REMEMBER` or `REMEMBER_TRUE` to arrays; return True if one is full.

    `rows`: robot states. `active`: robots to process, shape (n,), bool. `positions`: recorded estimated and true
    positions, shape (n, k, 4), float64 [m], updated. `counts`: their numbers, shape (n, 2), int64, updated.
    """
    is_full = False
    for k in range(rows.shape[0]):
        row, flags = rows[k], int(rows[k].pending)
        if not active[k]:
            continue
        for kind, (flag, (x, y), trail) in enumerate(
            ((REMEMBER, (row.pose[0], row.pose[1]), row.trail), (REMEMBER_TRUE, (row.x, row.y), row.true_trail))
        ):
            if flags & flag:
                trail[0], trail[1] = x, y
                positions[k, counts[k, kind], 2 * kind] = x
                positions[k, counts[k, kind], 2 * kind + 1] = y
                counts[k, kind] += 1
                is_full |= counts[k, kind] == positions.shape[1]
                row.pending -= flag
    return is_full


@njit(cache=True, error_model="numpy")
def drive(rows, draws, ranges, world_arrays, navigator, noted, max_steps, check_from):
    """Simulate a robot that follows its navigator for up to `max_steps` control periods.

    Stops earlier at the goal, on failure, or for work in Python: scan matching, checks, or new random numbers.
    `navigator`: arrays of the navigator, updated. `noted`: `positions` and `counts` of `record_positions`.
    `check_from`: first control period with a check in Python.

    Returns:
        Number of control periods; status of the drive as in `check_progress`, or `UNCHECKED`; number of control periods
        with contact, without the last one.
    """
    navigators, obstacles, constants = navigator.records, navigator.obstacles, navigator.numbers
    segments, circles, magnets, crowd = world_arrays
    row, record, no_points = rows[0], navigators[0], obstacles[:0]
    noted[1][:] = contacts = 0
    num_steps = min(max_steps, draws.shape[1] - 1 - int(row.draw))
    for k in range(num_steps):
        pose = as_tuple(row.pose, 3)
        v, w = compute_velocity_command(navigators, navigator.path, obstacles, pose, row.twist[0], constants)
        row.command[0], row.command[1] = v, w
        step_robots(rows, draws, ranges, segments, circles, magnets, crowd)
        update_robots(rows, crowd[0])
        flags, touched = int(row.pending), row.touched > 0.0
        record_positions(rows, ONE_ACTIVE, *noted)
        motion = as_tuple(row.odometry, 3)
        sensors = (ranges[0], navigator.geometry, touched)
        update_obstacles(navigators, obstacles, sensors, motion, no_points, constants)
        if flags & SCAN or k == num_steps - 1:
            return k + 1, UNCHECKED, contacts
        pose = as_tuple(row.pose, 3)
        progress = check_progress(navigators, obstacles, pose, touched, constants)
        if progress != DRIVING or record.steps >= check_from:
            return k + 1, progress, contacts
        contacts += touched
    return 0, UNCHECKED, contacts


def costs(rows: np.ndarray, num_robots: int) -> Any:
    """Return the number of robots in contact, plus that in personal spaces, by environment; shape (n,), float64."""
    each = (rows["touched"] > 0.0) + 1.0 * (rows["person_gap"] < PERSONAL_SPACE)
    return each.reshape(-1, num_robots).sum(axis=1)


def people_metrics(rows: np.ndarray) -> dict[str, float]:
    """Return the episode's metrics about people, over all robots: contacts, gaps and times."""
    hit_wall, hit_person, hit_by_person = rows["hits"].sum(axis=0).tolist()
    numbers = {"least_gap": rows["least_gap"].min(), "least_time_to_collision": rows["least_time"].min()}
    numbers = {name: float(number) for name, number in (numbers | {"intrusion_time": rows["intrusion"].sum()}).items()}
    return numbers | {"hit_wall": hit_wall, "hit_person": hit_person, "hit_by_person": hit_by_person}


@njit(cache=True, error_model="numpy")
def pose_errors(rows):
    """Return the errors of pose estimates, shape (num_robots, 2), float64: distance [m], angle [rad]."""
    errors = np.empty((rows.shape[0], 2))
    for k in range(rows.shape[0]):
        row = rows[k]
        start, pose, true = as_tuple(row.map_pose, 3), as_tuple(row.pose, 3), (row.x, row.y, row.theta)
        pose = compose(start[0], start[1], start[2], pose[0], pose[1], pose[2])
        dx, dy, turn = between(pose[0], pose[1], pose[2], true[0], true[1], true[2])
        errors[k, 0], errors[k, 1] = distance(dx, dy), abs(turn)
    return errors
