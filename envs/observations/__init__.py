"""Observation parts (dictionary entries), selected by name."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from lidarnaut.envs.files import resolve
from lidarnaut.envs.task import ObservationPart

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
    return parts


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
