"""Robots: their numbers as data, one YAML file each in `library/`, and wheel odometry."""

from .loader import ROBOT_NAMES, load_robot
from .odometry import WheelOdometry
from .params import (
    BodyParams,
    Caster,
    DriveParams,
    ImuParams,
    LidarParams,
    Mount,
    OdometryParams,
    RobotParams,
)

__all__ = [
    "ROBOT_NAMES",
    "BodyParams",
    "Caster",
    "DriveParams",
    "ImuParams",
    "LidarParams",
    "Mount",
    "OdometryParams",
    "RobotParams",
    "WheelOdometry",
    "load_robot",
]
