"""Argument checks, and default robots of worlds."""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, TypeGuard

import numpy as np

from lidarnaut.envs.robots import RobotParams, load_robot
from lidarnaut.envs.worlds import World

USUAL_ROBOT = "turtlebot3_burger"
"""Default robot of worlds without an entry in `USUAL_ROBOTS`."""
USUAL_ROBOTS = {
    "turtlebot3_house": "turtlebot3_waffle_pi",
    "tugbot_warehouse": "tugbot",
    "pimouse_arena": "raspimouse",
    "raspimouse_sample_maze": "raspimouse",
    "create3_maze": "create3",
    "barn": "jackal",
}
"""Default robot by world; `barn` stands for all worlds `barn:N`."""


def choose_robot(robot: str | RobotParams | None, world: str | World) -> RobotParams:
    """Return robot parameters for a name, a YAML path or `RobotParams`; None selects the world's default."""
    name = world if isinstance(world, str) else getattr(world, "name", "")
    return load_robot(USUAL_ROBOTS.get(name.partition(":")[0], USUAL_ROBOT) if robot is None else robot)


def is_pose(pose: Any, size: int = 3) -> bool:
    """Return True for a finite pose (x, y, theta), or with `size=2` a finite position (x, y)."""
    try:
        return len(pose) == size and all(math.isfinite(value) for value in pose)
    except (TypeError, OverflowError):
        # Not a sequence, not of numbers, or of integers too large for floats.
        return False


def is_number(value: Any) -> bool:
    """Return True if `value` is a finite real number."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer too large for a float
        return False


def is_whole(value: Any) -> TypeGuard[int]:
    """Return True if `value` is an integer of Python or NumPy."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def read_options(options: Any, allowed: Sequence[str] | None = None) -> dict[str, Any]:
    """Return a copy of the options of `reset`; raise ValueError if `options` is no mapping or has unknown names."""
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(f"options must map names to values, got {options!r}")
    if allowed is not None and (unknown := sorted(map(str, set(options or {}) - set(allowed)))):
        raise ValueError(f"reset has unknown options {unknown}; allowed are {list(allowed)}")
    return dict(options or {})


def check_positive(**values: float) -> None:
    """Raise ValueError for the first argument that is not positive and finite."""
    for name, value in values.items():
        if not (is_number(value) and value > 0):
            raise ValueError(f"{name} must be positive, got {value!r}")


def check_render_mode(mode: Any, allowed: Sequence[str]) -> None:
    """Raise ValueError for a mode that is not allowed; None always is."""
    if mode is not None and mode not in allowed:
        raise ValueError(f"render_mode must be None or one of {allowed}, got {mode!r}")


def check_time_limit(limit: Any) -> None:
    """Raise ValueError for a time limit [s] that is not positive; None and infinity are allowed."""
    if limit is not None and limit != math.inf and not (is_number(limit) and limit > 0):
        raise ValueError(f"time_limit must be positive or None, got {limit!r}")


def clip_hint(make_env: Callable[..., Any], actions: np.ndarray) -> str:
    """Return the part of an error message that suggests `clip_actions`; empty if not applicable."""
    if np.isnan(actions).any() or "clip_actions" not in inspect.signature(make_env).parameters:
        return ""
    return "; clip_actions=True clips actions to this range"


def read_action(action: Any) -> np.ndarray:
    """Return an action as an array; raise ValueError for a masked array, or if not of real numbers."""
    numbers = np.asarray(action)
    if numbers.dtype.kind not in "iuf" or isinstance(action, np.ma.MaskedArray):
        kind = "a masked array" if isinstance(action, np.ma.MaskedArray) else numbers.dtype
        raise ValueError(f"action must hold real numbers, got {kind}")
    return numbers


def read_fractions(action: Any, shape: Any, *, clips: bool, make_env: Callable[..., Any]) -> np.ndarray:
    """Return an action of fractions in [-1, 1] as an array of `shape`, float32, clipped with `clips`.

    `make_env`: class of the environment, for advice. ValueError for another shape, NaN, or numbers outside.
    """
    fractions = read_action(action).astype(np.float32, copy=False)
    if fractions.shape != shape:
        raise ValueError(f"action must have shape {shape}, got {fractions.shape}")
    if all(-1.0 <= value <= 1.0 for value in fractions.ravel().tolist()):
        return fractions
    if not clips or np.isnan(fractions).any():
        hint = clip_hint(make_env, fractions)
        raise ValueError(f"action must be finite and lie in [-1, 1], got {fractions}{hint}")
    return np.clip(fractions, -1.0, 1.0)
