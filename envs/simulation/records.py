"""Layout of the state vector (row) of a robot."""

import itertools
import math
from collections import namedtuple
from functools import lru_cache
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.lookup import as_tuple
from lidarnaut.envs.robots import RobotParams

SUBSTEP = 1.0 / 60.0
"""Target duration of a physics substep [s]."""
MAX_SUBSTEPS = 10_000
MIN_PERIOD = 1e-4

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
    "compass_offset": "imu.compass_offset",
    "compass_deviation": "imu.compass_deviation",
    "compass_deviation_phase": "imu.compass_deviation_phase",
    "compass_resolution": "imu.compass_resolution",
}

RobotRecord = namedtuple("RobotRecord", [*_SOURCES, "period", "substeps"])  # type: ignore[misc]
"""Robot parameters for Numba functions, all float, followed by control period [s] and substeps per period."""
RECORD_SIZE = len(RobotRecord._fields)


class OdometrySettings(NamedTuple):
    """Odometry settings of a robot, all float, for Numba functions. Randomization does not change them."""

    metres_per_tick: float
    track: float
    uses_gyro: float
    """1 for odometry from wheels and gyroscope, 0 for wheels only."""
    gyro_variance: float
    """Variance of the gyroscope noise [rad2/s2]."""
    bias_variance: float
    """Initial variance of the estimated gyroscope bias [rad2/s2]."""

    @classmethod
    def of(cls, robot: RobotParams) -> "OdometrySettings":
        odometry, imu = robot.odometry, robot.imu
        wheels = odometry.metres_per_tick, odometry.track, float(odometry.uses_gyro)
        return cls(*wheels, imu.gyro_std**2, imu.gyro_bias_std**2)


class MotionSettings(NamedTuple):
    """Estimator settings of a robot, all float, for Numba functions."""

    uses_truth: float
    """1 if the estimator receives the true motion instead of odometry, otherwise 0."""
    min_travel_distance: float
    """Minimum distance between key scans (scans that the estimator processes) [m]. Negative if every scan is processed,
    infinite if none."""
    min_travel_angle: float


_columns = itertools.count()


def _take(*sizes: int) -> list[int]:
    return [min(itertools.islice(_columns, size)) for size in sizes]


X, Y, THETA, COMMANDED_V, COMMANDED_W, LEFT_ANGLE, RIGHT_ANGLE, V, W, MEAN_W, GYRO_BIAS = _take(*[1] * 11)
"""Columns of the true state in a robot's state vector: pose in the world frame, velocities and wheel rotation in SI
units.

`COMMANDED_V`, `COMMANDED_W`: twist set by the speed controller, within the acceleration limits."""
STATE_SIZE = GYRO_BIAS + 1
LEFT_TICKS, RIGHT_TICKS, YAW_RATE, HEADING, TOUCHED = _take(*[1] * 5)
"""Columns of sensor measurements in a robot's state vector: encoder counts, yaw rate [rad/s], compass heading [rad],
contact.

`TOUCHED`: 0 without contact, 1 for an obstacle or robot, 2 plus index for a person."""
TOUCHED_PERSON = 2
STEPS, TIME = _take(1, 1)
"""Columns of time in a robot's state vector: control periods and time [s] since the reset."""
ODOMETRY, ODOMETRY_POSE = _take(3, 3)
"""First of three columns (x, y, theta) in a robot's state vector: odometry motion in the last control period, and
odometry pose since the reset."""
DRAW, COMMAND_V, COMMAND_W = _take(1, 1, 1)
"""Columns of the control command in a robot's state vector.

`DRAW`: index of the period's random numbers in `Rows.draws`. `COMMAND_V`, `COMMAND_W`: target twist [m/s, rad/s]."""
LAST_X, LAST_Y, LAST_THETA, LAST_TOUCHED = _take(*[1] * 4)
"""Columns of a robot's state vector: true pose and contact of the previous control period."""
MOTION, TWIST_V, TWIST_W, BIAS, BIAS_VARIANCE = _take(3, *[1] * 4)
"""Columns of motion estimates in a robot's state vector.

`MOTION`: first of three columns (x, y, theta) with the motion in the last control period for the pose estimator,
odometry or true motion. `BIAS`: estimate of the gyroscope bias [rad/s]."""
POSE, KEY_POSE, MAP_POSE, TRAIL, TRUE_TRAIL = _take(3, 3, 3, 2, 2)
"""First columns of poses (x, y, theta) and path points (x, y) in a robot's state vector.

`POSE`, `KEY_POSE`: estimated pose at present and at the last scan added to the map. `MAP_POSE`: map frame in the world
frame. `TRAIL`, `TRUE_TRAIL`: last point of the estimated and of the true path."""
PATH_LENGTH, COLLISIONS, ACTION_V, ACTION_W, FLAGS = _take(*[1] * 5)
"""Columns of a robot's state vector: driven distance [m], number of collisions, last action (v, w), and bit mask of
pending work such as adding a scan to the map."""
PERSON_GAP, LEAST_GAP, LEAST_TIME, INTRUSION, TOUCHED_BY, HIT_WALL, HIT_PERSON, HIT_BY_PERSON = _take(*[1] * 8)
"""Columns of statistics on nearby people and contacts in a robot's state vector: gaps [m], times [s], numbers of
contacts.

`INTRUSION`: time in the personal space of people. `TOUCHED_BY`: cause of the present contact, see `envs.transition`."""
LAST_V, ACCELERATION, JERK = _take(1, 1, 1)
"""Columns of the commanded motion (`COMMANDED_V`) in a robot's state vector: last speed [m/s], acceleration [m/s2],
magnitude of the jerk [m/s3]."""
(SLIP,) = _take(1)
"""Column of a robot's state vector: odometry distance in contact since the last processed scan [m]."""
MOTION_SETTINGS, ODOMETRY_SETTINGS = _take(len(MotionSettings._fields), len(OdometrySettings._fields))
ROBOT, ROW_SIZE = _take(RECORD_SIZE, 1)
"""First columns of estimator settings, odometry settings and robot parameters (`RobotRecord`) in a robot's state
vector, and its size."""
PERIOD = ROBOT + RobotRecord._fields.index("period")
SENSED = np.ones(ROW_SIZE)
"""Factors that hide ground truth in a robot's state vector, shape (ROW_SIZE,), float64: NaN for columns unknown to the
robot, else 1."""
SENSED[[*range(LEFT_TICKS), LAST_X, LAST_Y, LAST_THETA, LAST_TOUCHED, *range(MAP_POSE, TRAIL), TRUE_TRAIL]] = np.nan
SENSED[[TRUE_TRAIL + 1, PATH_LENGTH, FLAGS, *range(PERSON_GAP, SLIP), *range(ROBOT, PERIOD), PERIOD + 1]] = np.nan


@lru_cache(maxsize=64)
def robot_record(robot: RobotParams, control_period: float) -> Any:
    """Convert robot parameters and control period [s] to a flat record of floats (`RobotRecord`).

    Raises:
        ValueError: the control period is not finite, below `MIN_PERIOD`, or needs more than `MAX_SUBSTEPS`.
    """
    if not MIN_PERIOD <= control_period < math.inf:
        allowed = f"positive, finite and at least {MIN_PERIOD:g} s ({1.0 / MIN_PERIOD:,.0f} Hz)"
        raise ValueError(f"control_period must be {allowed}, got {control_period} s")
    fastest = robot.max_v * robot.drive.wheel_radius / robot.odometry.wheel_radius
    radii = 2.0 * control_period * fastest / robot.radius
    if not max(control_period / SUBSTEP, radii) <= MAX_SUBSTEPS:
        kind = f"{robot.name!r} (radius {robot.radius:g} m, speed {fastest:g} m/s)"
        steps = f"{MAX_SUBSTEPS:,} physics steps in a control period of {control_period:g} s"
        raise ValueError(f"robot {kind} needs more than {steps}")
    substeps = max(1, round(control_period / SUBSTEP), math.ceil(radii))
    return RobotRecord(*map(float, (*attrgetter(*_SOURCES.values())(robot), control_period, substeps)))


@njit(cache=True)
def unpack_robot(numbers):
    """Convert an array of robot parameters, shape (RECORD_SIZE,), float64, to a `RobotRecord` with named fields."""
    return RobotRecord(*as_tuple(numbers, RECORD_SIZE))
