"""The beams of a scan that a sensor model uses."""

import math

import numpy as np

from envs.robots import LidarParams
from envs.slam.scans import ScanGeometry, project_hits

from .params import AmclParams


class Beams:
    """The beams of a scan that are used."""

    def __init__(self, params: AmclParams, lidar: LidarParams, resolution: float) -> None:
        step = max(1, (lidar.num_beams - 1) // max(params.max_beams - 1, 1))
        self._picked = slice(0, step * (params.max_beams - 1) + 1, step)
        self.geometry = ScanGeometry.of(lidar, resolution)._replace(
            directions=np.ascontiguousarray(lidar.directions[:, self._picked]),
            range_max=float(min(params.max_range or math.inf, lidar.range_max)),
        )

    def pick(self, ranges: np.ndarray) -> np.ndarray:
        """Return the readings of these beams, shape (k,), float32 [m]."""
        return np.ascontiguousarray(ranges[self._picked])

    def hits(self, ranges: np.ndarray) -> tuple[np.ndarray, int]:
        """Return where beams end, shape (2, >= count), float32, base frame [cells], and the count of those that do."""
        points = np.empty((2, self.geometry.directions.shape[1]), dtype=np.float32)
        return points, project_hits(self.pick(ranges), self.geometry, points)
