"""Poses, occupancy grids and ray casting."""

from .occupancy_grid import FREE, OCCUPIED, OCCUPIED_FROM, UNKNOWN, OccupancyGrid
from .pose import ORIGIN, Pose2D, wrap_angle
from .window import NO_WINDOW, Window

__all__ = [
    "FREE",
    "NO_WINDOW",
    "OCCUPIED",
    "OCCUPIED_FROM",
    "ORIGIN",
    "UNKNOWN",
    "OccupancyGrid",
    "Pose2D",
    "Window",
    "wrap_angle",
]
