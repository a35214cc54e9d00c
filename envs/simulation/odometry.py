"""Odometry from wheel encoders and gyroscope."""

import math

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.lookup import as_tuple
from lidarnaut.envs.geometry.pose import compose
from lidarnaut.envs.geometry.rows import write_row

from . import records as at

NUM_SETTINGS = len(at.OdometrySettings._fields)


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
    innovation, total = row[at.YAW_RATE] - row[at.BIAS], row[at.BIAS_VARIANCE] + variance
    if row[at.BIAS_VARIANCE] > 0.0 and innovation * innovation <= 9.0 * total:
        gain = row[at.BIAS_VARIANCE] / total
        row[at.BIAS] += gain * innovation
        row[at.BIAS_VARIANCE] *= 1.0 - gain


@njit(cache=True, error_model="numpy")
def update_odometry(row, left_ticks, right_ticks):
    """Update a state vector with new encoder counts: counts, odometry motion, pose, and gyroscope bias.

    The first call after `Rows.reset` starts the odometry at the origin. Distances are from the wheels. Turns are from
    the wheels or, on robots such as the TurtleBot3, from the gyroscope, whose bias is estimated while the wheels rest
    (zero-velocity update). `row`: state vector with the new yaw rate.
    """
    setup = at.OdometrySettings(*as_tuple(row[at.ODOMETRY_SETTINGS : at.ROBOT], NUM_SETTINGS))
    left, right = int(left_ticks - row[at.LEFT_TICKS]), int(right_ticks - row[at.RIGHT_TICKS])
    row[at.LEFT_TICKS], row[at.RIGHT_TICKS] = left_ticks, right_ticks
    if row[at.STEPS] == 0.0:
        row[at.BIAS_VARIANCE] = setup.bias_variance
        _update_bias(row, setup.gyro_variance)
        return
    if setup.uses_gyro > 0.0:
        if left == 0 and right == 0:
            _update_bias(row, setup.gyro_variance)
        turn = (row[at.YAW_RATE] - row[at.BIAS]) * row[at.PERIOD]
        motion = arc_motion(0.5 * (left + right) * setup.metres_per_tick, turn)
    else:
        motion = wheel_motion(left, right, setup.metres_per_tick, setup.track)
    write_row(row[at.ODOMETRY :], motion)
    pose = row[at.ODOMETRY_POSE :]
    write_row(pose, compose(pose[0], pose[1], pose[2], motion[0], motion[1], motion[2]))
