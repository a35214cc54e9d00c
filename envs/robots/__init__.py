"""Robots: their parameters as data, one YAML file each in `library/`."""

from pathlib import Path

from lidarnaut.envs.files import read_record, resolve

from .params import (
    BodyParams,
    Caster,
    DriveParams,
    ImuParams,
    LidarParams,
    Mount,
    OdometryNoise,
    OdometryParams,
    RobotParams,
)

_LIBRARY = {path.stem: path for path in sorted((Path(__file__).parent / "library").glob("*.yaml"))}

ROBOT_NAMES: tuple[str, ...] = tuple(_LIBRARY)
"""Names of the robots in the library."""


def robots() -> tuple[str, ...]:
    """Return the names of the packaged robots, for the argument `robot` of environments."""
    return ROBOT_NAMES


def load_robot(robot: str | Path | RobotParams) -> RobotParams:
    """Return a robot by its name in the library, by the path of a YAML file, by `module:attribute`, or as it is.

    Raises:
        ValueError: the name is unknown, or the file misses a key, has one too many, or holds a value that makes no
            sense; the message names the file and the key.
        FileNotFoundError: there is no file at the path.
        TypeError: `robot` is none of these.
    """
    found = resolve(robot, _LIBRARY, "robot", files=True)
    if isinstance(found, Path):
        found = read_record(found, RobotParams)
    if not isinstance(found, RobotParams) and isinstance(robot, str):
        raise ValueError(f"robot {robot!r} must name RobotParams, got {found!r}")
    if not isinstance(found, RobotParams):
        raise TypeError(f"robot must be a name, a path, module:attribute or RobotParams, got {type(found).__name__}")
    return found


__all__ = [
    "ROBOT_NAMES",
    "BodyParams",
    "Caster",
    "DriveParams",
    "ImuParams",
    "LidarParams",
    "Mount",
    "OdometryNoise",
    "OdometryParams",
    "RobotParams",
    "load_robot",
    "robots",
]
