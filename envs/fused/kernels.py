"""One control step of many robots: kinematic physics and a SLAM that matches key scans. Kernels.

They call the functions that `KinematicSimulator` and the motion sources call. Between key scans a pose follows
odometry, as `KeyScanSlam` says.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from envs.estimation.motion import gyro_motion, wheel_motion
from envs.estimation.trail import TRAIL_SPACING
from envs.geometry.pose import between, compose, distance
from envs.simulation.kinematic import step_robots
from envs.simulation.sensors import LEFT_TICKS, RIGHT_TICKS, TOUCHED, YAW_RATE
from envs.simulation.state import THETA, X, Y
from envs.slam.key_scans import has_moved

KEY_SCAN, REMEMBER, REMEMBER_TRUE = 1, 2, 4
"""What is left to do for an environment: process its scan, a key scan, which corrects the pose; remember its estimated
position; remember its true position."""


class Rows(NamedTuple):
    """The numbers of all robots, a row each; units as in the objects that they copy."""

    robot: np.ndarray
    states: np.ndarray
    commands: np.ndarray
    draws: np.ndarray
    ranges: np.ndarray
    others: np.ndarray
    pose: np.ndarray
    key_pose: np.ndarray
    map_pose: np.ndarray
    ticks: np.ndarray
    twist: np.ndarray
    trail: np.ndarray
    true_trail: np.ndarray
    path_length: np.ndarray
    odometry: np.ndarray
    gyro: np.ndarray
    collisions: np.ndarray
    error: np.ndarray
    flags: np.ndarray
    active: np.ndarray


class Shapes(NamedTuple):
    """Arrays whose sizes differ from robot to robot."""

    segments: Any
    before: Any
    after: Any


class Setup(NamedTuple):
    """What all robots share."""

    period: float
    metres_per_tick: float
    track: float
    uses_gyro: bool
    gyro_variance: float
    uses_truth: bool
    min_travel_distance: float
    min_travel_angle: float


@njit(cache=True, error_model="numpy")
def _move(i, rows, shapes, setup):
    """Drive and sense for one control period; return the motion that the estimator learns of."""
    state, others = rows.states[i, 0], rows.others[i, 0]
    x, y, theta = state[X], state[Y], state[THETA]
    touched = others[TOUCHED]
    step_robots(
        rows.states[i],
        rows.commands[i],
        rows.draws[i],
        rows.robot[i],
        shapes.segments[i],
        shapes.before[i],
        shapes.after[i],
        rows.ranges[i],
        rows.others[i],
    )
    rows.collisions[i] += others[TOUCHED] > 0.0 and not touched > 0.0
    rows.path_length[i] += distance(state[X] - x, state[Y] - y)
    left, right = int(others[LEFT_TICKS] - rows.ticks[i, 0]), int(others[RIGHT_TICKS] - rows.ticks[i, 1])
    rows.ticks[i, 0], rows.ticks[i, 1] = others[LEFT_TICKS], others[RIGHT_TICKS]
    if setup.uses_gyro:
        rate, variance = others[YAW_RATE], setup.gyro_variance
        motion = gyro_motion(left, right, setup.metres_per_tick, rate, setup.period, rows.gyro[i], variance)
    else:
        motion = wheel_motion(left, right, setup.metres_per_tick, setup.track)
    rows.odometry[i, 0], rows.odometry[i, 1], rows.odometry[i, 2] = motion
    rows.twist[i, 0], rows.twist[i, 1] = motion[0] / setup.period, motion[2] / setup.period
    if setup.uses_truth:
        return between(x, y, theta, state[X], state[Y], state[THETA])
    return motion


@njit(cache=True, error_model="numpy")
def _is_apart(last, x, y):
    dx, dy = x - last[0], y - last[1]
    return dx * dx + dy * dy >= TRAIL_SPACING * TRAIL_SPACING


@njit(cache=True, error_model="numpy")
def step_rows(rows, shapes, setup):
    """Step the active robots for one control period, up to what `rows.flags` then asks for."""
    for i in range(rows.active.shape[0]):
        rows.flags[i] = 0
        if not rows.active[i]:
            continue
        motion = _move(i, rows, shapes, setup)
        pose = rows.pose[i]
        x, y, theta = compose(pose[0], pose[1], pose[2], motion[0], motion[1], motion[2])
        pose[0], pose[1], pose[2] = x, y, theta
        flags, last, state, start = 0, rows.key_pose[i], rows.states[i, 0], rows.map_pose[i]
        if has_moved(last[0], last[1], last[2], x, y, theta, setup.min_travel_distance, setup.min_travel_angle):
            flags |= KEY_SCAN
        elif _is_apart(rows.trail[i], x, y):
            flags |= REMEMBER
        if _is_apart(rows.true_trail[i], state[X], state[Y]):
            flags |= REMEMBER_TRUE
        world = compose(start[0], start[1], start[2], x, y, theta)
        dx, dy, turn = between(world[0], world[1], world[2], state[X], state[Y], state[THETA])
        rows.error[i, 0], rows.error[i, 1] = distance(dx, dy), abs(turn)
        rows.flags[i] = flags
