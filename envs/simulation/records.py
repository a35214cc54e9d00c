"""A simulated robot as a row of numbers, which both physics, the sensors and the kernels of a step share."""

import math
from collections import namedtuple
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np
from numba import njit

from lidarnaut.envs.geometry.lookup import as_tuple
from lidarnaut.envs.robots import RobotParams

SUBSTEP = 1.0 / 60.0
"""Target duration of one physics step [s]."""
MAX_SUBSTEPS = 10_000
"""Most physics steps in a control period."""
MIN_PERIOD = 1e-4
"""Shortest control period [s]."""

_SOURCES = {
    "radius": "radius",
    "max_v": "max_v",
    "max_w": "max_w",
    "max_acc_v": "max_acc_v",
    "max_acc_w": "max_acc_w",
    "wheel_radius": "drive.wheel_radius",
    "track": "drive.track",
    "slip_std": "drive.slip_std",
    "assumed_wheel_radius": "odometry.wheel_radius",
    "assumed_track": "odometry.track",
    "ticks_per_radian": "odometry.ticks_per_radian",
    "mount_x": "lidar.mount.x",
    "mount_y": "lidar.mount.y",
    "mount_z": "lidar.mount.z",
    "mount_yaw": "lidar.mount.yaw",
    "mount_pitch": "lidar.mount.pitch",
    "mount_roll": "lidar.mount.roll",
    "angle_min": "lidar.angle_min",
    "angle_increment": "lidar.angle_increment",
    "range_min": "lidar.range_min",
    "range_max": "lidar.range_max",
    "range_std": "lidar.noise_std",
    "range_resolution": "lidar.resolution",
    "dropout": "lidar.dropout",
    "gyro_std": "imu.gyro_std",
    "has_compass": "imu.has_compass",
    "compass_std": "imu.compass_std",
    "compass_resolution": "imu.compass_resolution",
}
"""Fields of `RobotRecord`, and the attributes of `RobotParams` that they hold; meaning and unit stand there."""

RobotRecord = namedtuple("RobotRecord", [*_SOURCES, "period", "substeps"])  # type: ignore[misc]
"""What kernels read of a robot, all of it float: `_SOURCES`, the control period [s], and into how many equal physics
steps it is cut."""
RECORD_SIZE = len(RobotRecord._fields)
"""Number of these."""
X, Y, THETA, COMMANDED_V, COMMANDED_W, LEFT_ANGLE, RIGHT_ANGLE, V, W, MEAN_W, GYRO_BIAS = range(11)
"""Ground truth: pose in the world frame [m, m, rad], the controller's twist after its ramp [m/s, rad/s], how far
the wheels have turned since the reset, as encoders measure it [rad], the true twist of the base [m/s, rad/s], its mean
yaw rate during the last control period, and the bias of its gyroscope [rad/s]."""
STATE_SIZE = 11
"""Number of these entries."""
LEFT_TICKS, RIGHT_TICKS, YAW_RATE, HEADING, TOUCHED = range(11, 16)
"""Measurements beside the scan: encoder counts, gyroscope [rad/s], compass [rad]; and 0 without contact, 1 for contact
with what rests or drives, `TOUCHED_PERSON` and its index for contact with a person."""
TOUCHED_PERSON = 2
STEPS, TIME, DRAW, COMMAND_V, COMMAND_W = range(16, 21)
"""Control periods and time [s] since the reset, row of `Rows.draws` in use, and commanded twist [m/s, rad/s]."""
LAST_X, LAST_Y, LAST_THETA, LAST_LEFT, LAST_RIGHT, LAST_TOUCHED = range(21, 27)
"""True pose, encoder counts and contact when the row was last brought up to date."""
ODOMETRY, MOTION, TWIST_V, TWIST_W, BIAS, BIAS_VARIANCE = 27, 30, *range(33, 37)
"""Motion during the period by odometry, and as the estimator learns of it (three entries each); velocity by odometry
or the estimator [m/s, rad/s]; the gyroscope's bias as odometry estimates it, and its variance."""
POSE, KEY_POSE, MAP_POSE, TRAIL, TRUE_TRAIL = 37, 40, 43, 46, 48
"""Pose estimate, predicted by odometry until the scan is processed, and that of the last key scan, map frame; pose of
the map frame in the world (three entries each); positions remembered last, estimated and true (two entries each)."""
PATH_LENGTH, COLLISIONS, ACTION_V, ACTION_W, FLAGS = range(50, 55)
"""Distance driven [m] and contacts so far, the last action, and what is left to do for the robot."""
PERSON_GAP, LEAST_GAP, LEAST_TIME, INTRUSION, TOUCHED_BY, HIT_WALL, HIT_PERSON, HIT_BY_PERSON = range(55, 63)
"""Gap between footprint and nearest person, and the least one so far [m]; least time to collision with a person at the
velocities of a moment [s]; time in personal space [s]; who caused a contact of this period, see
`lidarnaut.envs.transition`; and contacts so far in which the robot touched what rests, drove into a person, or a person
walked into it."""
SETUP, ROBOT = 63, 70
"""Where the `Setup` of `lidarnaut.envs.robot` and the robot's `RobotRecord` begin; both outlive a reset."""
PERIOD = ROBOT + RobotRecord._fields.index("period")
"""The control period [s]."""
ROW_SIZE = ROBOT + RECORD_SIZE
"""Number of entries of a row."""
SENSED = np.ones(ROW_SIZE)
"""Shape (ROW_SIZE,), float64: NaN for entries that hold ground truth, which a robot does not know, and 1 for others."""
SENSED[[*range(LEFT_TICKS), LAST_X, LAST_Y, LAST_THETA, LAST_TOUCHED, *range(MAP_POSE, TRAIL), TRUE_TRAIL]] = np.nan
SENSED[[TRUE_TRAIL + 1, PATH_LENGTH, FLAGS, *range(PERSON_GAP, SETUP), *range(ROBOT, PERIOD), PERIOD + 1]] = np.nan


@lru_cache(maxsize=64)
def robot_record(robot: RobotParams, control_period: float) -> Any:
    """Return the `RobotRecord` of a robot.

    A control period is cut into physics steps near 1/60 s, short enough that nothing moves by half the footprint's
    radius in one of them.

    Raises:
        ValueError: the control period is shorter than `MIN_PERIOD`, not finite, or so long for the robot's speed that
            it takes more than `MAX_SUBSTEPS`.
    """
    if not MIN_PERIOD <= control_period < math.inf:
        raise ValueError(
            f"control_period must be positive, finite and at least {MIN_PERIOD:g} s ({1.0 / MIN_PERIOD:,.0f} Hz), "
            f"got {control_period} s"
        )
    fastest = robot.max_v * robot.drive.wheel_radius / robot.odometry.wheel_radius
    radii = 2.0 * control_period * fastest / robot.radius
    if not max(control_period / SUBSTEP, radii) <= MAX_SUBSTEPS:
        raise ValueError(
            f"robot {robot.name!r} (radius {robot.radius:g} m, speed {fastest:g} m/s) needs more than {MAX_SUBSTEPS:,} "
            f"physics steps in a control period of {control_period:g} s"
        )
    substeps = max(1, round(control_period / SUBSTEP), math.ceil(radii))
    numbers = attrgetter(*_SOURCES.values())(robot)
    return RobotRecord(*map(float, (*numbers, control_period, substeps)))


@njit(cache=True)
def unpack_robot(numbers):
    """Return the `RobotRecord` whose fields an array holds, shape (30,), float64.

    Handing an array to a compiled function takes 0.1 us, a named tuple 0.1 us for each number in it.
    """
    return RobotRecord(*as_tuple(numbers, RECORD_SIZE))
