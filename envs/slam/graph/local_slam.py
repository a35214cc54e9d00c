import dataclasses

import numpy as np

from lidarnaut.envs.geometry import Pose2D, distance, wrap_angle
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.slam.log_odds_map import LogOddsMap
from lidarnaut.envs.slam.matching.covariance import correct_covariance, motion_stds, predict_covariance
from lidarnaut.envs.slam.matching.fields import LEAST_SUBMAP_SHARE, fits_map
from lidarnaut.envs.slam.matching.scan_matcher import MatcherParams, match_to_levels
from lidarnaut.envs.slam.slam_params import GraphSlamParams

from .nodes import NodeStore

CORRELATION = 5.0
"""Factor that enlarges the covariance of a node pose in its submap: errors of successive nodes are correlated."""
NODE_STD = (0.03, 0.03, 0.008)
"""Minimum standard deviations of a node pose in its submap [m, m, rad]."""
SUBMAP_RANGE = 12.0
"""Maximum lidar range assumed for the initial size of a submap [m]."""


def submap_params(params: GraphSlamParams, lidar: LidarParams) -> GraphSlamParams:
    """Return graph SLAM parameters with the initial map size of a submap."""
    side = 2.0 * (min(lidar.range_max, SUBMAP_RANGE) + params.submap_spacing * params.min_travel_distance)
    return dataclasses.replace(params, map_width=side, map_height=side)


class LocalSlam:
    """Scan matching to submaps (maps of some tens of scans) without loop-closure corrections.

    Poses are in the local frame, whose origin is the start pose.
    """

    def __init__(self, params: GraphSlamParams, lidar: LidarParams, nodes: NodeStore) -> None:
        self._params, self._lidar, self._nodes = params, lidar, nodes
        self._matcher = MatcherParams.of(params)
        self._submap_params = submap_params(params, lidar)
        self._points = np.empty((2, lidar.num_beams), dtype=np.float32)
        self.pose = Pose2D(0.0, 0.0, 0.0)
        """Base pose at the last matched scan, without loop-closure corrections."""
        self.travelled = 0.0
        self.active: list[int] = []
        """Indices of unfinished submaps, oldest first. Scans are matched to the oldest."""
        self._maps: dict[int, LogOddsMap] = {}
        self._covariances: dict[int, np.ndarray] = {}

    def match(self, ranges: np.ndarray, motion: Pose2D, slip: float = 0.0) -> bool | None:
        """Match a scan, shape (num_beams,), float32 [m], to the oldest unfinished submap; return whether the scan fits.

        `motion`: odometry since the last matched scan; `slip`: its part in contact [m]. The result is None if too few
        cells are known.
        """
        before, matcher = self.pose, self._matcher.in_contact(slip)
        self.pose = predicted = before.compose(motion)
        self.travelled += distance(motion.x, motion.y)
        if not self.active:
            return None
        first = self.active[0]
        submap, origin = self._maps[first], self._nodes.submap_pose(first)
        over = (submap.geometry, submap.levels, submap.sums, submap.corner)
        poses = (tuple(origin.between(before)), tuple(origin.between(predicted)))
        match = match_to_levels(ranges, *over, *poses, matcher, self._covariances[first], self._points)
        dx, dy, turn = predicted.x - before.x, predicted.y - before.y, wrap_angle(predicted.theta - before.theta)
        stds = motion_stds(matcher.odometry_noise, distance(dx, dy), turn)
        for other in self.active[1:]:
            # Same correction as the matcher's for the first submap.
            covariance = self._covariances[other]
            predict_covariance(covariance, dx, dy, *stds)
            if match.fits:
                scale = (self._params.residual_variance, self._params.resolution)
                correct_covariance(covariance, match.fit, match.num_hits, *scale)
            if match.is_far:
                covariance[:] = self._covariances[first]
        if not match.fits:
            return False
        self.pose = origin.compose(Pose2D(match.x, match.y, match.theta))
        points = self._points[:, : match.num_hits]
        return fits_map(submap.grid, points, (match.x, match.y, match.theta), LEAST_SUBMAP_SHARE)

    def relocate(self, pose: Pose2D) -> None:
        """Set the pose of a relocalized robot, local frame of scan matching; the next scan starts a new submap."""
        self.pose, self.active, self._maps, self._covariances = pose, [], {}, {}
        self._nodes.first_joined = len(self._nodes)

    def add_node(self, ranges: np.ndarray) -> int:
        """Add a scan at the current pose to all unfinished submaps; start and finish submaps when due."""
        nodes = self._nodes
        if not self.active or len(nodes) % self._params.submap_spacing == 0:
            self.active = [*self.active[-1:], nodes.add_submap(self.travelled)]
            self._covariances = {k: self._covariances.get(k, np.zeros((3, 3))) for k in self.active}
            self._maps = {k: self._maps.get(k) or LogOddsMap(self._submap_params, self._lidar) for k in self.active}
        node = nodes.add_node(ranges, self.pose, self.active)
        for submap, map in self._maps.items():
            map.integrate(ranges, nodes.submap_pose(submap).between(self.pose))
        return node

    def constraint_covariance(self, submap: int) -> np.ndarray:
        """Return the covariance of the last node pose in a submap, shape (3, 3), float64, submap frame [m^2, rad^2]."""
        return CORRELATION * self._covariances[submap] + np.diag(np.square(NODE_STD))
