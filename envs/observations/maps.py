"""Egocentric crops of the map."""

from typing import Any

import numpy as np
from gymnasium import spaces
from numba import njit

from lidarnaut.envs.arguments import is_number, is_whole
from lidarnaut.envs.estimation.map_pyramid import crop_level
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import records as at

MAX_SIZE = 4096
"""Most pixels along a side of a map crop."""


@njit(cache=True, error_model="numpy")
def crop_levels(levels, sizes, origins, rows, side, pixel, active, out):
    """Crop the maps around active rows to `out`, shape (n, 3, size, size), uint8; see `crop_level`.

    For `levels`, `sizes`, `origins` and `side` see `Batch.levels`; `pixel` is the side of a pixel [blocks].
    """
    for k in range(active.shape[0]):
        if active[k]:
            x, y = (rows[k, at.POSE] - origins[k, 0]) / side, (rows[k, at.POSE + 1] - origins[k, 1]) / side
            crop_level(levels[k], sizes[k, 0], sizes[k, 1], x, y, rows[k, at.POSE + 2], pixel, out[k])


class MapCrop:
    """The robot's map around it: axis 1 points forward, axis 2 to the left, the robot in the middle.

    Channels: 0 occupied, 1 free, 2 where a robot has been. Unknown is 0 in channels 0 and 1.
    """

    def __init__(self, resolution: float, size: int = 40) -> None:
        """Choose what to show.

        Args:
            resolution: side of a pixel [m].
            size: pixels along each side. Both checkers of environments (Gymnasium, stable-baselines3) want 36 or more.

        Raises:
            ValueError: one of them is not positive, or the size not whole or beyond `MAX_SIZE`.
        """
        if not (is_number(resolution) and resolution > 0):
            raise ValueError(f"a map crop needs a positive resolution, got {resolution!r}")
        if not (is_whole(size) and 1 <= size <= MAX_SIZE):
            raise ValueError(f"a map crop needs a whole size from 1 to {MAX_SIZE:,}, got {size!r}")
        self.resolution = resolution
        """Side of a pixel [m]."""
        self._size = int(size)

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(0, 255, (3, size, size), uint8)`."""
        return spaces.Box(0, 255, (3, self._size, self._size), np.uint8)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the crop to `out`."""
        robot.pyramid.crop(*robot.belief.pose, self.resolution, out)

    def write_rows(self, batch: Any, out: np.ndarray) -> None:
        """Write the crops of many robots; see `RowPart`."""
        levels, sizes, origins, side = batch.levels(self.resolution)
        crop_levels(levels, sizes, origins, batch.numbers, side, self.resolution / side, batch.active, out)
