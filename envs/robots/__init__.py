"""Robot parameters, loaded from the YAML files in `library/`."""

from pathlib import Path

from lidarnaut.envs.files import read_record, resolve

from .robot_params import (
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


def robots() -> tuple[str, ...]:
    """Return the names of the packaged robots, for the argument `robot` of environments."""
    return ROBOT_NAMES


def load_robot(robot: str | Path | RobotParams) -> RobotParams:
    """Return the parameters of a robot.

    Args:
        robot: name in the library, path of a YAML file, import path `module:attribute`, or the parameters themselves.

    Raises:
        ValueError: the name is unknown, or the file has missing or unknown keys or invalid values.
        FileNotFoundError: the path does not exist.
        TypeError: `robot` has another type.
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
