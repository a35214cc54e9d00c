"""Egocentric crops of the occupancy grid."""

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.arguments import is_number, is_whole
from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation.map_pyramid import crop_level
from lidarnaut.envs.robot_rows import RobotRows
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.task import RowPart

MAX_SIZE = 4096
"""Maximum number of pixels along a side of a map crop."""


@njit(cache=True, error_model="numpy")
def crop_levels(maps, frames, rows, resolution, active, out):
    """Write the observation `MapCrop` of n robots to `out`, shape (n, 3, size, size), uint8.

    `maps`, `frames`: as returned by `RobotRows.levels`. `active`: robots to write (mask).
    """
    for k in range(active.shape[0]):
        if active[k]:
            left, low, side, height, width = frames[k]
            x, y = (rows[k].pose[0] - left) / side, (rows[k].pose[1] - low) / side
            crop_level(maps[k], int(height), int(width), x, y, rows[k].pose[2], resolution / side, out[k])


class MapCrop(RowPart):
    """Observation of the map around the robot: `Box(0, 255, (3, size, size), uint8)`.

    Axis 1 points forward, axis 2 to the left. Channels: 0 occupied, 1 free, 2 visited. Unknown is 0 in channels 0 and
    1.
    """

    def __init__(self, resolution: float, size: int = 40) -> None:
        """Set resolution and size.

        Args:
            resolution: side of a pixel [m].
            size: pixels per side; environment checkers require 36 or more.

        Raises:
            ValueError: not positive, or `size` not an integer up to `MAX_SIZE`.
        """
        if not (is_number(resolution) and resolution > 0):
            raise ValueError(f"a map crop needs a positive resolution, got {resolution!r}")
        if not (is_whole(size) and 1 <= size <= MAX_SIZE):
            raise ValueError(f"a map crop needs a whole size from 1 to {MAX_SIZE:,}, got {size!r}")
        self.resolution = resolution
        self._size = int(size)

    def space(self, robot: RobotParams) -> spaces.Box:
        return spaces.Box(0, 255, (3, self._size, self._size), np.uint8)

    def _write(self, rows: RobotRows, out: np.ndarray) -> None:
        maps, frames = rows.levels(self.resolution)
        crop_levels(maps, frames, rows.numbers, self.resolution, rows.active, out)
