"""Endless worlds by seed."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from ..world import World
from . import caves, maze, rooms, warehouse
from .plan import UNIT, Size, units

_FAMILIES: dict[str, tuple[Callable[[str, np.random.Generator, Size], World], float, Size, Size]] = {
    "rooms": (rooms.build, 4.0, (8.0, 7.0), (14.0, 12.0)),
    "maze": (maze.build, 3.0, (7.0, 7.0), (13.0, 13.0)),
    "warehouse": (warehouse.build, 6.0, (16.0, 12.0), (30.0, 22.0)),
    "caves": (caves.build, 4.0, (9.0, 9.0), (16.0, 16.0)),
}
"""What makes a world from its name, a generator and its outer size; the smallest side, and the range of sizes [m]."""


def _generate(family: str, seed: int, size: Size | None = None) -> World:
    """Return a world of a family.

    Args:
        family: a name in `FAMILIES`.
        seed: world seed; the same seed and size give the same bytes.
        size: outer size (x, y) [m], rounded to whole units; drawn from the family's range by default.

    Raises:
        ValueError: if the size is not two numbers from the family's smallest to 200 m.
    """
    build, smallest, low, high = _FAMILIES[family]
    rng = np.random.default_rng(seed)
    if size is None:
        size = (float(rng.uniform(low[0], high[0])), float(rng.uniform(low[1], high[1])))
    if len(size) != 2 or not all(math.isfinite(side) and smallest <= side <= 200 for side in size):
        raise ValueError(f"size must be (width, height), both from {smallest} to 200 m, got {size!r}")
    return build(f"{family}-{seed}", rng, (units(size[0]) * UNIT, units(size[1]) * UNIT))


FAMILIES: dict[str, Callable[[int, Size | None], World]] = {name: partial(_generate, name) for name in _FAMILIES}
"""Generators of worlds: seed and optional outer size [m] in, world out. Even seeds train, odd ones test."""
