"""Checks of arguments, and robots by the world that they are usual in."""

import inspect
import math
from collections.abc import Callable, Mapping
from numbers import Integral, Real
from typing import Any, TypeGuard

import numpy as np

from lidarnaut.envs.robots import RobotParams, load_robot
from lidarnaut.envs.worlds import World

USUAL_ROBOT = "turtlebot3_burger"
"""Robot of worlds that `USUAL_ROBOTS` does not name."""
USUAL_ROBOTS = {
    "turtlebot3_house": "turtlebot3_waffle_pi",
    "tugbot_warehouse": "tugbot",
    "pimouse_arena": "raspimouse",
    "raspimouse_sample_maze": "raspimouse",
    "create3_maze": "create3",
    "barn": "jackal",
}
"""Robot that a world is driven with when none is named; `barn` stands for `barn:0` and all others."""


def choose_robot(robot: str | RobotParams | None, world: str | World) -> RobotParams:
    """Return a robot by name, path or as it is; for None the world's usual one."""
    name = world if isinstance(world, str) else getattr(world, "name", "")
    return load_robot(USUAL_ROBOTS.get(name.partition(":")[0], USUAL_ROBOT) if robot is None else robot)


def is_pose(pose: Any, size: int = 3) -> bool:
    """Return True for (x, y, theta), all finite; with `size=2` for (x, y)."""
    try:
        return len(pose) == size and all(math.isfinite(value) for value in pose)
    except TypeError:
        # No sequence, or one of something else than numbers.
        return False


def is_number(value: Any) -> bool:
    """Tell whether something is a real number, not infinite and not NaN."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # a whole number beyond all floating-point ones
        return False


def is_whole(value: Any) -> TypeGuard[int]:
    """Tell whether something is a whole number, of Python or of NumPy."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def read_options(options: Any) -> dict[str, Any]:
    """Return a copy of the options of a reset; ValueError if they are not by name."""
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(f"options must map names to values, got {options!r}")
    return dict(options or {})


def check_positive(**values: float) -> None:
    """Refuse numbers that are not positive and finite; ValueError names the first of them."""
    for name, value in values.items():
        if not (is_number(value) and value > 0):
            raise ValueError(f"{name} must be positive, got {value!r}")


def clip_hint(make_env: Callable[..., Any], actions: np.ndarray) -> str:
    """Return what to add to the refusal of actions outside [-1, 1] where an argument of the environment helps."""
    if np.isnan(actions).any() or "clip_actions" not in inspect.signature(make_env).parameters:
        return ""
    return "; clip_actions=True clips what lies outside"


def read_action(action: Any) -> np.ndarray:
    """Return an action, or several, as an array; ValueError if they are no numbers, or masked, which would count."""
    numbers = np.asarray(action)
    if numbers.dtype.kind not in "iuf" or isinstance(action, np.ma.MaskedArray):
        kind = "a masked array" if isinstance(action, np.ma.MaskedArray) else numbers.dtype
        raise ValueError(f"action must hold real numbers, got {kind}")
    return numbers
