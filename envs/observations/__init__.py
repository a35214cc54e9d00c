"""Observation parts (dictionary entries), selected by name."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from lidarnaut.envs.files import resolve
from lidarnaut.envs.robot_rows import RobotRows
from lidarnaut.envs.task import ObservationPart, RowPart

from .maps import MapCrop
from .plan import Plan
from .positions import Battery, Goal, Home, NearGoal, Peers, PoseUncertainty, RouteAhead, Tracks
from .scan import Limits, Motion, Scan
from .scan_history import ScanHistory
from .trajectories import Trajectories

NEAR_PIXEL = 0.2
"""Side of a pixel of the map crop `map_near` [m]."""
FAR_PIXEL = 0.8
"""Side of a pixel of the map crop `map_far` [m]."""
PARTS: dict[str, Callable[..., ObservationPart]] = {
    "scan": Scan,
    "scan_history": ScanHistory,
    "map_near": partial(MapCrop, resolution=NEAR_PIXEL),
    "map_far": partial(MapCrop, resolution=FAR_PIXEL),
    "motion": Motion,
    "limits": Limits,
    "plan": Plan,
    "tracks": Tracks,
    "trajectories": Trajectories,
}
"""Constructors of observation parts (dictionary entries) that all tasks offer, by name."""

Observations = Sequence[str] | Mapping[str, Any]
"""Names of observation parts, or a mapping from each name to the part: an instance, class, import path
`module:attribute`, keyword arguments such as `{"map_near": {"resolution": 0.1, "size": 64}}`, or None for defaults."""


def make_parts(
    observations: Observations, own: Mapping[str, Callable[..., ObservationPart]]
) -> dict[str, ObservationPart]:
    """Create the selected observation parts (dictionary entries) by name; `own`: constructors of the task's own parts.

    Raises:
        ValueError: an unknown name, no name, or a value that is not an observation part.
    """
    table = {**PARTS, **own}
    if isinstance(observations, str) or not isinstance(observations, Iterable):
        raise ValueError(f"observations must be a sequence of names or a mapping from them, got {observations!r}")
    names = list(observations)
    if wrong := [name for name in names if not isinstance(name, str)]:
        raise ValueError(f"names of observations must be strings, got {wrong[0]!r}")
    chosen = dict(observations) if isinstance(observations, Mapping) else dict.fromkeys(names)
    if not chosen:
        raise ValueError(f"observations must name at least one of {', '.join(table)}")
    parts = {}
    for name, choice in chosen.items():
        if choice is None or isinstance(choice, Mapping):
            parts[name] = resolve(name, table, "observation")(**(choice or {}))
        else:
            found = resolve(choice, table, "observation")
            if not (hasattr(found, "write") or callable(found)):
                raise ValueError(f"observations: {name!r} must be an observation part or return one, got {choice!r}")
            parts[name] = found if hasattr(found, "write") and not isinstance(found, type) else found()
        _check_methods(name, parts[name])
    return parts


def _check_methods(name: str, part: Any) -> None:
    wanted = "robot, out, truth" if getattr(part, "uses_ground_truth", False) else "robot, out"
    try:
        inspect.signature(part.write).bind(*wanted.split(", "))
        own = [kind for kind in type(part).__mro__ if not kind.__module__.startswith("lidarnaut.")]
        if isinstance(part, RowPart) and any("_write" in vars(kind) for kind in own):
            raise TypeError("_write is private")  # it would receive ground truth
    except (AttributeError, TypeError) as error:
        kind = type(part).__name__
        raise ValueError(f"observations: {name!r} must have write({wanted}), got {kind}: {error}") from None


def reset_parts(parts: Mapping[str, Any], robots: Sequence[Any]) -> None:
    """Start an episode of observation parts that keep state."""
    for part in parts.values():
        for robot in robots if hasattr(part, "reset") else ():
            part.reset(robot)


def writes_rows(part: Any) -> bool:
    """Return whether a part writes the entries of all robots at once: a `RowPart` whose `write` is not overridden."""
    return getattr(part.write, "__func__", None) is RowPart.write


def write_entries(part: Any, rows: RobotRows, out: np.ndarray) -> None:
    """Write the observation entries of all robots to `out`, shape (n, ...); those of users' parts one by one."""
    if writes_rows(part):
        part._write(rows, out)
        return
    shows_truth = getattr(part, "uses_ground_truth", False)
    for k, robot in enumerate(rows.robots):
        part.write(robot, out[k, ...], *rows.truths[k : k + shows_truth])


__all__ = [
    "FAR_PIXEL",
    "NEAR_PIXEL",
    "PARTS",
    "Battery",
    "Goal",
    "Home",
    "Limits",
    "MapCrop",
    "Motion",
    "NearGoal",
    "Observations",
    "Peers",
    "Plan",
    "PoseUncertainty",
    "RouteAhead",
    "Scan",
    "ScanHistory",
    "Tracks",
    "Trajectories",
    "make_parts",
]
