"""Poses, occupancy grids and ray casting: the geometry that every other folder uses."""

import lidarnaut.envs.compilation  # noqa: F401

from .occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from .pose import Pose2D, wrap_angle

__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "OccupancyGrid", "Pose2D", "wrap_angle"]
