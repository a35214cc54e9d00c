"""Worlds: a library of known places, endless procedural ones, and map files."""

from .raster import check_world, free_area, leaks, rasterize, reachable
from .world import Mover, World

__all__ = ["Mover", "World", "check_world", "free_area", "leaks", "rasterize", "reachable"]
