"""Mapping at poses that are told."""

import numpy as np

from envs.geometry import Pose2D
from envs.robots import LidarParams

from .grid_map import GridMap
from .params import TinySlamParams
from .slam import NO_CELLS, Belief
from .tinyslam import check_scan

_ORIGIN = Pose2D(0.0, 0.0, 0.0)


class GivenPoseSlam:
    """Draws the same map as TinySLAM, at the pose that the motions lead to: odometry's, or the truth."""

    def __init__(self, lidar: LidarParams, params: TinySlamParams) -> None:
        """Build a mapper for one lidar; of `params` only what concerns the map is used."""
        self.params = params
        self._lidar = lidar
        self.reset(np.random.default_rng(0))

    @property
    def belief(self) -> Belief:
        """The current belief."""
        return self._belief

    def reset(self, rng: np.random.Generator, start: Pose2D = _ORIGIN, shared_map: GridMap | None = None) -> Belief:
        """Forget everything: an unknown map with the robot at its origin; see `TinySlam`. Draws nothing from `rng`."""
        self.map = GridMap(self.params, self._lidar) if shared_map is None else shared_map
        self._belief = Belief(start, self.map.grid, NO_CELLS)
        return self._belief

    def update(self, ranges: np.ndarray, motion: Pose2D) -> Belief:
        """Take in one scan.

        Args:
            ranges: shape (num_beams,), float32 [m]: +inf for no return, NaN for a beam to ignore.
            motion: pose of the base now, seen from the base at the previous scan.

        Raises:
            ValueError: if the scan has another number of beams, or the motion is not finite.
        """
        ranges = check_scan(ranges, motion, self._lidar)
        self._belief.pose = self._belief.pose.compose(motion)
        self.map.offer(ranges, self._belief, self.params.quality)
        return self._belief
