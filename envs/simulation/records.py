"""Layout of the record (row) of a robot: true state, measurements, estimates, statistics and parameters."""

import math
from collections import namedtuple
from functools import lru_cache
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.lookup import as_tuple, record_type
from lidarnaut.envs.robots import RobotParams

SUBSTEP = 1.0 / 60.0
"""Target duration of a physics substep [s]."""
MAX_SUBSTEPS = 10_000
MIN_PERIOD = 1e-4

_SOURCES = {
    **{name: name for name in ("radius", "max_v", "max_w", "max_acc_v", "max_acc_w")},
    **{name: f"drive.{name}" for name in ("wheel_radius", "track", "slip_std")},
    **{f"assumed_{name}": f"odometry.{name}" for name in ("wheel_radius", "track")},
    "ticks_per_radian": "odometry.ticks_per_radian",
    **{f"mount_{name}": f"lidar.mount.{name}" for name in ("x", "y", "z", "yaw", "pitch", "roll")},
    **{name: f"lidar.{name}" for name in ("angle_min", "angle_increment", "range_min", "range_max")},
    "range_std": "lidar.noise_std",
    "range_resolution": "lidar.resolution",
    "dropout": "lidar.dropout",
    **{name: f"imu.{name}" for name in ("gyro_std", "has_compass", "compass_std", "compass_offset")},
    **{f"compass_{name}": f"imu.compass_{name}" for name in ("deviation", "deviation_phase", "resolution")},
}
"""Attributes of `RobotParams` by field of `RobotRecord`."""

RobotRecord = namedtuple("RobotRecord", [*_SOURCES, "period", "substeps"])  # type: ignore[misc]
"""Robot parameters for Numba functions, all float, followed by control period [s] and substeps per period."""
NUM_PARAMETERS = len(_SOURCES) - 1
"""Number of robot parameters after the footprint radius."""


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


class Fields(NamedTuple):
    """Fields of a robot's record: names, number of values in each, and whether the robot knows them."""

    names: str
    size: int = 1
    is_sensed: bool = False
    """Whether policies may read the fields; the others are ground truth, which `Robot.row` hides."""


FIELDS = (
    Fields("x y theta"),  # pose in the world frame
    Fields("commanded_v commanded_w"),  # twist set by the speed controller, within the acceleration limits
    Fields("left_angle right_angle v w mean_w gyro_bias"),  # wheel rotations, twist, mean yaw rate
    Fields("left_ticks right_ticks yaw_rate heading", is_sensed=True),  # encoder counts, gyroscope, compass
    Fields("touched", is_sensed=True),  # 0 without contact, 1 for an obstacle or robot, 2 plus index for a person
    Fields("steps time", is_sensed=True),  # control periods and time since the reset
    Fields("odometry odometry_pose", 3, is_sensed=True),  # motion in the last control period, pose since the reset
    Fields("draw", is_sensed=True),  # index of the period's random numbers in `Rows.draws`
    Fields("command", 2, is_sensed=True),  # target twist
    Fields("last_pose", 3),  # `x`, `y`, `theta` and `touched` of the previous control period
    Fields("last_touched"),
    Fields("motion", 3, is_sensed=True),  # in the last control period, for the estimator: odometry or true motion
    Fields("twist", 2, is_sensed=True),  # estimate
    Fields("bias bias_variance", is_sensed=True),  # estimate of the gyroscope bias
    Fields("pose key_pose", 3, is_sensed=True),  # estimates at present and at the last scan added to the map
    Fields("map_pose", 3),  # map frame in the world frame
    Fields("trail", 2, is_sensed=True),  # last point (x, y) of the estimated path
    Fields("true_trail", 2),
    Fields("path_length"),
    Fields("collisions action_v action_w", is_sensed=True),  # number of collisions, last action
    Fields("pending"),  # bit mask of pending work such as adding a scan to the map
    Fields("person_gap least_gap least_time intrusion"),  # gaps to people, times to collision and in personal space
    Fields("touched_by"),  # cause of the present contact, see `envs.transition`
    Fields("hits", 3),  # numbers of contacts by cause
    Fields("last_v acceleration jerk"),  # of `commanded_v`; magnitude of the jerk
    Fields("slip", is_sensed=True),  # odometry distance in contact since the last processed scan
    Fields("motion_settings", len(MotionSettings._fields), is_sensed=True),
    Fields("odometry_settings", len(OdometrySettings._fields), is_sensed=True),
    Fields("radius"),  # from here on `RobotRecord`
    Fields("robot", NUM_PARAMETERS),
    Fields("period", is_sensed=True),
    Fields("substeps"),
)
"""Fields of a robot's record, in SI units; poses are x, y, theta, twists v, w."""
ROW = record_type(
    [(name, np.float64, () if each.size == 1 else each.size) for each in FIELDS for name in each.names.split()]
)
"""Dtype of a robot's record."""
SENSED = np.concatenate(
    [np.full(each.size * len(each.names.split()), 1.0 if each.is_sensed else np.nan) for each in FIELDS]
)
"""Factors that hide ground truth in a robot's record, float64: NaN for fields unknown to the robot, else 1."""
NUM_RESET = ROW.fields["motion_settings"][1] // 8  # type: ignore[index]
"""Number of values at the beginning of a record that a reset sets to zero."""
TOUCHED_PERSON = 2


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
def unpack_robot(row):
    """Return the robot parameters in a robot's record as a `RobotRecord`."""
    return RobotRecord(*(row.radius, *as_tuple(row.robot, NUM_PARAMETERS), row.period, row.substeps))
