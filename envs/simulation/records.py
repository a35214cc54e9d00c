"""The numbers of a robot and its control period as a named tuple, which Python and Numba share."""

import math
from collections import namedtuple
from functools import lru_cache
from operator import attrgetter
from typing import Any

from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple

from envs.robots import RobotParams

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
    needed = max(1.0, control_period / SUBSTEP, 2.0 * control_period * fastest / robot.radius)
    if not needed <= MAX_SUBSTEPS:
        raise ValueError(
            f"robot {robot.name!r} (radius {robot.radius:g} m, speed {fastest:g} m/s) needs {needed:.3g} physics "
            f"steps in a control period of {control_period:g} s, at most {MAX_SUBSTEPS:,} are allowed"
        )
    substeps = max(1, round(control_period / SUBSTEP), math.ceil(2.0 * control_period * fastest / robot.radius))
    numbers = attrgetter(*_SOURCES.values())(robot)
    return RobotRecord(*map(float, (*numbers, control_period, substeps)))


_SIZE = len(RobotRecord._fields)


@njit(cache=True)
def unpack_robot(numbers):
    """Return the `RobotRecord` whose fields an array holds, shape (30,), float64.

    Handing an array to a compiled function takes 0.1 us, a named tuple 0.1 us for each number in it.
    """
    return RobotRecord(*to_fixed_tuple(numbers, _SIZE))  # type: ignore[call-arg]
