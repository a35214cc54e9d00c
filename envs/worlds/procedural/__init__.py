"""Endless worlds by seed."""

from collections.abc import Callable

from ..world import World
from . import caves, maze, rooms, warehouse

FAMILIES: dict[str, Callable[[int, tuple[float, float] | None], World]] = {
    "rooms": rooms.generate,
    "maze": maze.generate,
    "warehouse": warehouse.generate,
    "caves": caves.generate,
}
"""Generators of worlds: seed and optional outer size [m] in, world out. Even seeds train, odd ones test."""

__all__ = ["FAMILIES"]
