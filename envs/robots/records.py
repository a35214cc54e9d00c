"""The numbers of a robot as named tuples, which Python and Numba share."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple

from .params import DriveParams, ImuParams, LidarParams, OdometryParams, RobotParams


class DriveRecord(NamedTuple):
    """What moves the robot; see `RobotParams`, `DriveParams` and `OdometryParams`."""

    max_v: float
    """Greatest forward speed [m/s]."""
    max_w: float
    """Greatest yaw rate [rad/s]."""
    max_acc_v: float
    """Greatest change of forward speed [m/s2]."""
    max_acc_w: float
    """Greatest change of yaw rate [rad/s2]."""
    wheel_radius: float
    """Radius of the wheels [m]."""
    track: float
    """Distance between the wheels [m]."""
    assumed_wheel_radius: float
    """Wheel radius that the controller assumes [m]."""
    assumed_track: float
    """Track that the controller assumes [m]."""
    slip_std: float
    """Standard deviation of the distance that a wheel slips while it rolls 1 m [m]."""
    radius: float
    """Radius of the footprint [m]."""


class LidarRecord(NamedTuple):
    """The numbers of `LidarParams`; units as there."""

    mount_x: float
    mount_y: float
    mount_yaw: float
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    noise_std: float
    resolution: float
    dropout: float


class ImuRecord(NamedTuple):
    """The numbers of `ImuParams`; units as there."""

    gyro_std: float
    has_compass: float
    """1 for a robot with a compass, 0 for one without."""
    compass_std: float
    compass_resolution: float


class RobotRecord(NamedTuple):
    """All numbers of a robot that kernels read."""

    drive: DriveRecord
    lidar: LidarRecord
    imu: ImuRecord
    ticks_per_radian: float
    """Encoder counts per radian of a wheel's turn."""


@lru_cache(maxsize=64)
def robot_record(robot: RobotParams) -> RobotRecord:
    """Return the numbers of a robot."""
    return RobotRecord(
        _drive_record(robot, robot.drive, robot.odometry),
        _lidar_record(robot.lidar),
        _imu_record(robot.imu),
        robot.odometry.ticks_per_radian,
    )


def pack_robot(record: RobotRecord) -> np.ndarray:
    """Return the numbers in one array, float64, for `unpack_robot`.

    Handing an array to a compiled function takes 0.1 us, a named tuple 0.1 us for each number in it.
    """
    return np.array([*record.drive, *record.lidar, *record.imu, record.ticks_per_radian], dtype=np.float64)


_LIDAR = len(DriveRecord._fields)
_IMU = _LIDAR + len(LidarRecord._fields)
_REST = _IMU + len(ImuRecord._fields)
_SIZE = _REST + 1


@njit(cache=True)
def unpack_robot(numbers):
    """Return the `RobotRecord` that `pack_robot` packed."""
    n: Any = to_fixed_tuple(numbers, _SIZE)  # type: ignore[call-arg]
    return RobotRecord(DriveRecord(*n[:_LIDAR]), LidarRecord(*n[_LIDAR:_IMU]), ImuRecord(*n[_IMU:_REST]), n[_REST])


def _drive_record(robot: RobotParams, wheels: DriveParams, assumed: OdometryParams) -> DriveRecord:
    limits = (robot.max_v, robot.max_w, robot.max_acc_v, robot.max_acc_w)
    dimensions = (wheels.wheel_radius, wheels.track, assumed.wheel_radius, assumed.track)
    return DriveRecord(*map(float, (*limits, *dimensions, wheels.slip_std, robot.radius)))


def _lidar_record(lidar: LidarParams) -> LidarRecord:
    mount = (lidar.mount.x, lidar.mount.y, lidar.mount.yaw)
    angles = (lidar.angle_min, lidar.angle_increment)
    noise = (lidar.noise_std, lidar.resolution, lidar.dropout)
    return LidarRecord(*map(float, (*mount, *angles, lidar.range_min, lidar.range_max, *noise)))


def _imu_record(imu: ImuParams) -> ImuRecord:
    return ImuRecord(*map(float, (imu.gyro_std, imu.has_compass, imu.compass_std, imu.compass_resolution)))
