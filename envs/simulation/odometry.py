"""Odometry from wheel encoders and gyroscope."""

import math

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.lookup import as_tuple
from lidarnaut.envs.geometry.pose import compose
from lidarnaut.envs.geometry.rows import write_row

from .records import OdometrySettings

NUM_SETTINGS = len(OdometrySettings._fields)


@njit(cache=True, error_model="numpy")
def arc_motion(distance, turn):
    """Return the end pose (x, y, theta) of an arc relative to its start, from signed length [m] and turn [rad]."""
    half = 0.5 * turn
    chord = distance * math.sin(half) / half if half != 0.0 else distance
    return chord * math.cos(half), chord * math.sin(half), turn


@njit(cache=True, error_model="numpy")
def wheel_motion(left_ticks, right_ticks, metres_per_tick, track):
    """Return the displacement (x, y, theta) from wheel encoder counts; `track`: distance between the wheels [m]."""
    left, right = left_ticks * metres_per_tick, right_ticks * metres_per_tick
    return arc_motion(0.5 * (left + right), (right - left) / track)


@njit(cache=True, error_model="numpy")
def _update_bias(row, variance):
    innovation, total = row.yaw_rate - row.bias, row.bias_variance + variance
    if row.bias_variance > 0.0 and innovation * innovation <= 9.0 * total:
        gain = row.bias_variance / total
        row.bias += gain * innovation
        row.bias_variance *= 1.0 - gain


@njit(cache=True, error_model="numpy")
def update_odometry(row, left_ticks, right_ticks):
    """Update a robot's record with new encoder counts: counts, odometry motion, pose, and gyroscope bias.

    The first call after `Rows.reset` starts the odometry at the origin. Distances are from the wheels. Turns are from
    the wheels or, on robots such as the TurtleBot3, from the gyroscope, whose bias is estimated while the wheels rest
    (zero-velocity update). `row`: record with the new yaw rate.
    """
    setup = OdometrySettings(*as_tuple(row.odometry_settings, NUM_SETTINGS))
    left, right = int(left_ticks - row.left_ticks), int(right_ticks - row.right_ticks)
    row.left_ticks, row.right_ticks = left_ticks, right_ticks
    if row.steps == 0.0:
        row.bias_variance = setup.bias_variance
        _update_bias(row, setup.gyro_variance)
        return
    if setup.uses_gyro > 0.0:
        if left == 0 and right == 0:
            _update_bias(row, setup.gyro_variance)
        turn = (row.yaw_rate - row.bias) * row.period
        motion = arc_motion(0.5 * (left + right) * setup.metres_per_tick, turn)
    else:
        motion = wheel_motion(left, right, setup.metres_per_tick, setup.track)
    write_row(row.odometry, motion)
    pose = row.odometry_pose
    write_row(pose, compose(pose[0], pose[1], pose[2], motion[0], motion[1], motion[2]))
