"""Endless worlds by seed."""

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
    """Makes a world from its name, a generator and its outer size."""
    smallest: Size
    """Smallest outer size [m]."""
    low: Size
    """From where sizes are drawn [m]."""
    high: Size
    """Up to where they are drawn [m]."""
    radius: float = 0.25
    """Robots up to this radius get everywhere that they should [m]; see `plan.REACH`."""


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
        size = tuple(np.maximum(rng.uniform(one.low, one.high), smallest).tolist())
    if not _is_size(size, smallest):
        larger = f" for a robot of a radius of {radius:g} m" if scale > 1.0 else ""
        least = f"{smallest[0]:g} x {smallest[1]:g} m{larger}"
        raise ValueError(f"size must be (width, height), from {least} to 200 x 200 m, got {size!r}")
    if difficulty is not None and family != "clutter":
        raise ValueError(f"difficulty is for clutter; {family!r} has none")
    build = partial(clutter.build, difficulty=difficulty) if family == "clutter" else one.build
    world = build(f"{family}-{seed}", rng, (units(size[0] / scale) * UNIT, units(size[1] / scale) * UNIT))
    return world.scaled(scale) if scale > 1.0 else world


def _is_size(size: Any, smallest: Size) -> bool:
    try:
        return len(size) == 2 and all(least <= side <= 200 for side, least in zip(size, smallest))
    except TypeError:  # no sequence, or one of something else than numbers
        return False


FAMILIES: dict[str, Callable[..., World]] = {name: partial(_generate, name) for name in _FAMILIES}
"""Generators of worlds: seed, optional outer size [m], radius of the robot [m] and difficulty in, world out. Even seeds
train, odd ones test."""
