"""Simulated worlds from library files, procedural families and map files."""

from .barn import BARN_NAMES
from .explorable import ExplorableArea, explorable_area
from .library import WORLD_NAMES, load_world, world_sampler
from .map_files import load_map, save_map
from .map_worlds import world_from_map
from .procedural import FAMILIES
from .raster import check_world, free_area, rasterize, reachable
from .world import FixedRoute, World


def worlds() -> tuple[str, ...]:
    """Return the names of worlds that the argument `world` of environments accepts.

    These are the worlds of the library, the procedural families, and `barn:0` to `barn:299` of the BARN benchmark.
    """
    return (*WORLD_NAMES, *FAMILIES, *BARN_NAMES)


__all__ = [
    "BARN_NAMES",
    "FAMILIES",
    "WORLD_NAMES",
    "ExplorableArea",
    "FixedRoute",
    "World",
    "check_world",
    "explorable_area",
    "free_area",
    "load_map",
    "load_world",
    "rasterize",
    "reachable",
    "save_map",
    "world_from_map",
    "world_sampler",
    "worlds",
]
