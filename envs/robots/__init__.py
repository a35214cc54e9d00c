"""Robot parameters, loaded from the YAML files in `library/`."""

from pathlib import Path

from lidarnaut.envs.files import read_record, resolve, write_file

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
from .urdf import urdf_text

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


def export_urdf(robot: str | Path | RobotParams, path: str | Path) -> Path:
    """Write a robot as a URDF file; return its path.

    Links are `base_footprint`, `base_link` and `laser`, as in recorded bags, `wheel_left_link`, `wheel_right_link`, and
    `caster_0_link` onwards. The wheel joints turn about the y axis; their limits are the torque of a motor [N m] and
    the rate of the faster wheel at `max_v` and `max_w` [rad/s]. Frames without a mass get a thousandth of the body's,
    as PyBullet assumes 1 kg. Friction coefficients are in the extensions of PyBullet (`contact`) and Gazebo (`mu1`,
    `mu2`). Sensor parameters, odometry and noise are left out.

    Args:
        robot: name in the library, path of a YAML file, import path `module:attribute`, or the parameters themselves.
        path: file `NAME.urdf`; an existing file is replaced.

    Raises:
        ValueError: the robot is unknown or invalid, or the file has another suffix.
        FileNotFoundError: the YAML file does not exist.
        TypeError: `robot` has another type.
        OSError: the file cannot be written.
    """
    path = Path(path)
    if path.suffix != ".urdf":
        raise ValueError(f"robots are exported as .urdf, got {path}")
    write_file(path, urdf_text(load_robot(robot)))
    return path


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
    "export_urdf",
    "load_robot",
    "robots",
]
