from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ..world import World
from . import caves, clutter, halls, maze, passages, rooms, warehouse, wings
from .plan import UNIT, Size, units


@dataclass(frozen=True, slots=True)
class _Family:
    build: Callable[..., World]
    smallest: Size
    """Minimum outer size (x, y) [m]."""
    low: Size
    """Lower limit of random outer sizes (x, y) [m]."""
    high: Size
    """Upper limit of random outer sizes (x, y) [m]."""
    radius: float = 0.25
    """Robot radius that worlds are designed for [m]; worlds are scaled up for larger robots."""


_FAMILIES = {
    "rooms": _Family(rooms.build, (4.0, 4.0), (8.0, 7.0), (14.0, 12.0)),
    "maze": _Family(maze.build, (3.0, 3.0), (7.0, 7.0), (13.0, 13.0)),
    "warehouse": _Family(warehouse.build, (6.0, 6.0), (16.0, 12.0), (30.0, 22.0)),
    "caves": _Family(caves.build, (4.0, 4.0), (9.0, 9.0), (16.0, 16.0)),
    "wings": _Family(wings.build, (7.0, 7.0), (12.0, 10.0), (30.0, 24.0)),
    "halls": _Family(halls.build, (4.0, 4.0), (6.0, 6.0), (24.0, 18.0)),
    "clutter": _Family(clutter.build, (12.0, 21.0), (14.5, 23.0), (14.5, 23.0), 0.333),
    "hall": _Family(passages.build_hall, (5.0, 5.0), (10.0, 10.0), (14.0, 14.0), 0.4),
    "corridor": _Family(passages.build_corridor, (4.2, 4.2), (15.0, 4.8), (25.0, 5.7), 0.4),
    "doorway": _Family(passages.build_doorway, (5.5, 3.5), (9.0, 6.0), (14.0, 9.0), 0.4),
    "crossing": _Family(passages.build_crossing, (7.0, 7.0), (12.0, 12.0), (18.0, 18.0), 0.4),
}


def _generate(
    family: str, seed: int, size: Size | None = None, radius: float = 0.0, difficulty: float | None = None
) -> World:
    """Generate a world of a procedural family; equal arguments give identical worlds.

    `size`: outer size (x, y) [m], rounded to grid cells; `radius`: of the robot [m], scales everything except the outer
    size; `difficulty`: of the family `clutter`, from 0 to 1. None draws a value.

    Raises:
        ValueError: `size` or `difficulty` is out of range.
    """
    one = _FAMILIES[family]
    scale = max(1.0, radius / one.radius)
    smallest = (one.smallest[0] * scale, one.smallest[1] * scale)
    rng = np.random.default_rng(seed)
    if size is None:
        size = tuple(np.maximum(rng.uniform(one.low, one.high), smallest).tolist())
    if not _is_size(size, smallest):
        larger = f" for a robot of a radius of {radius:g} m" if scale > 1.0 else ""
        least = f"{smallest[0]:g} x {smallest[1]:g} m{larger}"
        raise ValueError(f"size must be (width, height), from {least} to 200 x 200 m, got {size!r}")
    if difficulty is not None and family != "clutter":
        raise ValueError(f"difficulty applies to the family 'clutter' only, not to {family!r}")
    build = partial(clutter.build, difficulty=difficulty) if family == "clutter" else one.build
    world = build(f"{family}-{seed}", rng, (units(size[0] / scale) * UNIT, units(size[1] / scale) * UNIT))
    return world.scaled(scale) if scale > 1.0 else world


def _is_size(size: Any, smallest: Size) -> bool:
    try:
        return len(size) == 2 and all(least <= side <= 200 for side, least in zip(size, smallest))
    except TypeError:  # not a sequence of numbers
        return False


FAMILIES: dict[str, Callable[..., World]] = {name: partial(_generate, name) for name in _FAMILIES}
"""World generators by family: functions of seed (even: training, odd: testing) and optionally outer size (x, y) [m],
robot radius [m] and difficulty (0 to 1)."""
