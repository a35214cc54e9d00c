"""Robots: their numbers as data, one YAML file each in `library/`, and wheel odometry."""

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
    "BodyParams",
    "Caster",
    "DriveParams",
    "ImuParams",
    "LidarParams",
    "Mount",
    "OdometryParams",
    "RobotParams",
]
