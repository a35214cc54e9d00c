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
from .records import DriveRecord, ImuRecord, LidarRecord, RobotRecord, pack_robot, robot_record, unpack_robot

__all__ = [
    "ROBOT_NAMES",
    "BodyParams",
    "Caster",
    "DriveParams",
    "DriveRecord",
    "ImuParams",
    "ImuRecord",
    "LidarParams",
    "LidarRecord",
    "Mount",
    "OdometryParams",
    "RobotParams",
    "RobotRecord",
    "load_robot",
    "pack_robot",
    "robot_record",
    "unpack_robot",
]
