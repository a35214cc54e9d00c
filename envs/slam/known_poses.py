"""Mapping with known poses."""

import numpy as np

from envs.geometry import Pose2D

from .grid_map import GridMap
from .key_scans import KeyScanSlam
from .params import TinySlamParams


class KnownPoses(KeyScanSlam):
    """Builds the same map as TinySLAM, at the poses that its motion source gives: odometry, or ground truth.

    Only what concerns the map is used of its `params`, which are `TinySlamParams`.
    """

    params: TinySlamParams

    def _make_map(self) -> GridMap:
        return GridMap(self.params, self._lidar)

    def _match(self, ranges: np.ndarray, predicted: Pose2D) -> tuple[Pose2D, float | None]:
        return predicted, self.params.quality
