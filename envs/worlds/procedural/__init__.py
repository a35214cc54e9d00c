"""Endless worlds by seed."""

import math
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
    """How the worlds of a family are made."""

    build: Callable[..., World]
    """Makes a world from its name, a generator and its outer size, and from its difficulty if there are such."""
    smallest: Size
    """Smallest outer size [m]."""
    low: Size
    """From where sizes are drawn [m]."""
    high: Size
    """Up to where they are drawn [m]."""
    radius: float = 0.25
    """Robots up to this radius get everywhere that they should [m]; see `plan.REACH`."""
    has_difficulty: bool = False


_FAMILIES = {
    "rooms": _Family(rooms.build, (4.0, 4.0), (8.0, 7.0), (14.0, 12.0)),
    "maze": _Family(maze.build, (3.0, 3.0), (7.0, 7.0), (13.0, 13.0)),
    "warehouse": _Family(warehouse.build, (6.0, 6.0), (16.0, 12.0), (30.0, 22.0)),
    "caves": _Family(caves.build, (4.0, 4.0), (9.0, 9.0), (16.0, 16.0)),
    "wings": _Family(wings.build, (7.0, 7.0), (12.0, 10.0), (30.0, 24.0)),
    "halls": _Family(halls.build, (4.0, 4.0), (6.0, 6.0), (24.0, 18.0)),
    "clutter": _Family(clutter.build, (12.0, 21.0), (14.5, 23.0), (14.5, 23.0), 0.333, has_difficulty=True),
    "hall": _Family(passages.build_hall, (5.0, 5.0), (10.0, 10.0), (14.0, 14.0), 0.4),
    "corridor": _Family(passages.build_corridor, (4.2, 4.2), (15.0, 4.8), (25.0, 5.7), 0.4),
    "doorway": _Family(passages.build_doorway, (5.5, 3.5), (9.0, 6.0), (14.0, 9.0), 0.4),
    "crossing": _Family(passages.build_crossing, (7.0, 7.0), (12.0, 12.0), (18.0, 18.0), 0.4),
}


def _generate(
    family: str, seed: int, size: Size | None = None, radius: float = 0.0, difficulty: float | None = None
) -> World:
    """Return a world of a family; the same arguments give the same bytes.

    A robot of a radius of 0.25 m (of some families larger) fits everywhere that it should. For one of a larger `radius`
    [m] everything is larger, but for the outer `size` (x, y) [m]. This is rounded to whole units; by default it is
    drawn from the family's range, and at least as large as its smallest. `difficulty` is for `clutter`, from 0 to 1, by
    default drawn.

    Raises:
        ValueError: if the size is not two numbers from the family's smallest, for this robot, to 200 m; or the
            difficulty is not from 0 to 1, or the family has none.
    """
    one = _FAMILIES[family]
    scale = max(1.0, radius / one.radius)
    smallest = (one.smallest[0] * scale, one.smallest[1] * scale)
    rng = np.random.default_rng(seed)
    if size is None:
        drawn = (float(rng.uniform(one.low[0], one.high[0])), float(rng.uniform(one.low[1], one.high[1])))
        size = (max(drawn[0], smallest[0]), max(drawn[1], smallest[1]))
    if not _is_size(size, smallest):
        larger = f" for a robot of a radius of {radius:g} m" if scale > 1.0 else ""
        least = f"{smallest[0]:g} x {smallest[1]:g} m{larger}"
        raise ValueError(f"size must be (width, height), from {least} to 200 x 200 m, got {size!r}")
    options: dict[str, float] = {}
    if difficulty is not None:
        if not one.has_difficulty:
            having = ", ".join(name for name, other in _FAMILIES.items() if other.has_difficulty)
            raise ValueError(f"difficulty is for {having}; {family!r} has none")
        if not 0.0 <= difficulty <= 1.0:
            raise ValueError(f"difficulty must lie in [0, 1], got {difficulty!r}")
        options["difficulty"] = float(difficulty)
    world = one.build(
        f"{family}-{seed}", rng, (units(size[0] / scale) * UNIT, units(size[1] / scale) * UNIT), **options
    )
    return world.scaled(scale) if scale > 1.0 else world


def _is_size(size: Any, smallest: Size) -> bool:
    try:
        return len(size) == 2 and all(
            math.isfinite(side) and least <= side <= 200 for side, least in zip(size, smallest)
        )
    except TypeError:  # no sequence, or one of something else than numbers
        return False


FAMILIES: dict[str, Callable[..., World]] = {name: partial(_generate, name) for name in _FAMILIES}
"""Generators of worlds: seed, optional outer size [m], radius of the robot [m] and difficulty in, world out. Even seeds
train, odd ones test."""
