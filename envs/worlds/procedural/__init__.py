"""Endless worlds by seed."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from ..world import World
from . import caves, halls, maze, rooms, warehouse, wings
from .plan import UNIT, Size, units

_FAMILIES: dict[str, tuple[Callable[[str, np.random.Generator, Size], World], float, Size, Size]] = {
    "rooms": (rooms.build, 4.0, (8.0, 7.0), (14.0, 12.0)),
    "maze": (maze.build, 3.0, (7.0, 7.0), (13.0, 13.0)),
    "warehouse": (warehouse.build, 6.0, (16.0, 12.0), (30.0, 22.0)),
    "caves": (caves.build, 4.0, (9.0, 9.0), (16.0, 16.0)),
    "wings": (wings.build, 7.0, (12.0, 10.0), (30.0, 24.0)),
    "halls": (halls.build, 4.0, (6.0, 6.0), (24.0, 18.0)),
}
"""What makes a world from its name, a generator and its outer size; the smallest side, and the range of sizes [m]."""
FITTING_RADIUS = 0.25
"""Robots up to this radius get everywhere in a plan [m]; see `plan.REACH`."""


def _generate(family: str, seed: int, size: Size | None = None, radius: float = 0.0) -> World:
    """Return a world of a family; the same seed and size give the same bytes.

    A robot of a radius of 0.25 m fits everywhere that it should. For one of a larger `radius` [m] everything is larger,
    but for the outer `size` (x, y) [m]. This is rounded to whole units; by default it is drawn from the family's range,
    and at least as large as its smallest.

    Raises:
        ValueError: if the size is not two numbers from the family's smallest, for this robot, to 200 m.
    """
    build, smallest, low, high = _FAMILIES[family]
    scale = max(1.0, radius / FITTING_RADIUS)
    smallest *= scale
    rng = np.random.default_rng(seed)
    if size is None:
        drawn = (float(rng.uniform(low[0], high[0])), float(rng.uniform(low[1], high[1])))
        size = (max(drawn[0], smallest), max(drawn[1], smallest))
    if not _is_size(size, smallest):
        larger = f" for a robot of a radius of {radius:g} m" if scale > 1.0 else ""
        raise ValueError(f"size must be (width, height), both from {smallest:g} to 200 m{larger}, got {size!r}")
    world = build(f"{family}-{seed}", rng, (units(size[0] / scale) * UNIT, units(size[1] / scale) * UNIT))
    return world.scaled(scale) if scale > 1.0 else world


def _is_size(size: Any, smallest: float) -> bool:
    try:
        return len(size) == 2 and all(math.isfinite(side) and smallest <= side <= 200 for side in size)
    except TypeError:  # no sequence, or one of something else than numbers
        return False


FAMILIES: dict[str, Callable[..., World]] = {name: partial(_generate, name) for name in _FAMILIES}
"""Generators of worlds: seed, optional outer size [m] and radius of the robot [m] in, world out. Even seeds train, odd
ones test."""
