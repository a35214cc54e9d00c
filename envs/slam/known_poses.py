"""Mapping with known poses."""

import numpy as np

from envs.estimation import NO_UPDATE, ORIGIN, Belief
from envs.geometry import Pose2D
from envs.robots import LidarParams

from .grid_map import GridMap, has_moved
from .params import TinySlamParams
from .scans import check_scan


class KnownPoses:
    """Builds the same map as TinySLAM, at the poses that its motion source gives: odometry, or ground truth."""

    shares_maps = True
    """Whether several robots may integrate their scans into one map."""

    def __init__(self, lidar: LidarParams, params: TinySlamParams) -> None:
        """Build a mapper for one lidar; only what concerns the map is used of `params`."""
        self.params = params
        self._lidar = lidar
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator, pose: Pose2D = ORIGIN, map: GridMap | None = None) -> Belief:
        """Start at a known pose, map frame, with an unknown map or one that other robots integrate into as well."""
        self.rng = rng
        self.map = GridMap(self.params, self._lidar) if map is None else map
        self.last_integrated_pose: Pose2D | None = None
        self.belief = Belief(pose, self.map.grid)
        return self.belief

    def update(self, ranges: np.ndarray, motion: Pose2D) -> Belief:
        """Process one scan.

        Args:
            ranges: shape (num_beams,), float32 [m]: +inf for no return, NaN for a beam to ignore.
            motion: pose of the base now, as the motion source sees it from the base at the previous scan.

        Raises:
            ValueError: if the scan has another number of beams, or the motion is not finite.
        """
        ranges, params, belief = check_scan(ranges, motion, self._lidar), self.params, self.belief
        belief.pose, quality = self._locate(ranges, motion)
        last = self.last_integrated_pose
        belief.update = NO_UPDATE
        if last is None or has_moved(*last, *belief.pose, params.min_travel_distance, params.min_travel_angle):
            belief.update = self.map.integrate(ranges, belief.pose, quality)
            self.last_integrated_pose = belief.pose
        return belief

    def _locate(self, ranges: np.ndarray, motion: Pose2D) -> tuple[Pose2D, float]:
        """Return the pose after a motion, and the weight of a scan that is taken there."""
        return self.belief.pose.compose(motion), self.params.quality
