"""Poses, occupancy grids and ray casting."""

from .occupancy_grid import FREE, OCCUPIED, OCCUPIED_FROM, UNKNOWN, OccupancyGrid
from .pose import ORIGIN, Pose2D, distance, wrap_angle
from .rows import GrowingArray
from .window import NO_WINDOW, Window

__all__ = [
    "FREE",
    "NO_WINDOW",
    "OCCUPIED",
    "OCCUPIED_FROM",
    "ORIGIN",
    "UNKNOWN",
    "GrowingArray",
    "OccupancyGrid",
    "Pose2D",
    "Window",
    "distance",
    "wrap_angle",
]
