"""Robots: their parameters as data, one YAML file each in `library/`."""

from .loader import ROBOT_NAMES, load_robot
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
    "load_robot",
]
