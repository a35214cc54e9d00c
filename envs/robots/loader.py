"""Reading robots from YAML."""

import os
from functools import cache
from pathlib import Path

import yaml
from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from .params import RobotParams

_LIBRARY = Path(__file__).parent / "library"

ROBOT_NAMES: tuple[str, ...] = tuple(sorted(path.stem for path in _LIBRARY.glob("*.yaml")))
"""Names of the robots in the library."""


def load_robot(robot: str | Path | RobotParams) -> RobotParams:
    """Return a robot by its name in the library, by the path of a YAML file, or as it is.

    Raises:
        ValueError: the name is unknown, or the file misses a key, has one too many, or holds a value that makes no
            sense; the message names the file and the key.
        FileNotFoundError: there is no file at the path.
        TypeError: `robot` is none of the three.
    """
    if isinstance(robot, RobotParams):
        return robot
    if not isinstance(robot, (str, Path)):
        raise TypeError(f"robot must be a name, a path or RobotParams, got {type(robot).__name__}")
    if robot in ROBOT_NAMES:
        return _read(_LIBRARY / f"{robot}.yaml")
    path = Path(robot)
    if path.suffix not in (".yaml", ".yml") and os.sep not in str(robot):
        raise ValueError(f"unknown robot {str(robot)!r}; choose one of {', '.join(ROBOT_NAMES)}, or give a YAML file")
    if not path.is_file():
        raise FileNotFoundError(f"no robot file at {path}; the library has {', '.join(ROBOT_NAMES)}")
    return _read(path)


@cache
def _adapter() -> TypeAdapter[RobotParams]:
    return TypeAdapter(RobotParams)


def _read(path: Path) -> RobotParams:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a YAML file: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected a mapping of keys to values, got {type(content).__name__}")
    try:
        return _adapter().validate_python(content)
    except ValidationError as error:
        faults = [f"{_key(fault['loc'])}: {_complaint(fault)}" for fault in error.errors()]
        raise ValueError(f"{path}: " + "; ".join(faults)) from error


def _key(location: tuple[int | str, ...]) -> str:
    return ".".join(str(key) for key in location) or "robot"


def _complaint(fault: ErrorDetails) -> str:
    return "unknown key" if fault["type"] == "unexpected_keyword_argument" else fault["msg"]
