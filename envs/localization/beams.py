"""The beams of a scan that a sensor model uses."""

import math

import numpy as np

from envs.robots import LidarParams
from envs.slam.matcher import project_hits

from .params import AmclParams


class Beams:
    """The beams of a scan that are used."""

    def __init__(self, params: AmclParams, lidar: LidarParams, resolution: float) -> None:
        step = max(1, (lidar.num_beams - 1) // max(params.max_beams - 1, 1))
        self._picked = slice(0, step * (params.max_beams - 1) + 1, step)
        self.angles = lidar.angles[self._picked] + lidar.mount.yaw
        """Shape (k,), float64: directions in the base frame [rad]."""
        self.range_max = min(params.max_range or math.inf, lidar.range_max)
        """Readings from this on count as no return [m]."""
        self.mount = lidar.mount.x, lidar.mount.y
        """Position of the lidar in the base frame [m]."""
        self._directions = np.stack([np.cos(self.angles), np.sin(self.angles)])
        self._resolution = resolution
        self._points = np.empty((2, len(self.angles)), dtype=np.float32)

    def pick(self, ranges: np.ndarray) -> np.ndarray:
        """Return the readings of these beams, shape (k,), float32 [m]."""
        return np.ascontiguousarray(ranges[self._picked])

    def hits(self, ranges: np.ndarray) -> tuple[np.ndarray, int]:
        """Return where beams end, shape (2, >= count), float32, base frame [cells], and the count of those that do."""
        picked = self.pick(ranges)
        count = project_hits(picked, self.range_max, self._directions, *self.mount, self._resolution, self._points)
        return self._points, count
