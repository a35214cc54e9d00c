"""TinySLAM: match each scan to the map by Monte Carlo search, then integrate it."""

from collections.abc import Sequence

import numpy as np

from envs.estimation import ORIGIN, Belief
from envs.geometry import Pose2D, wrap_angle
from envs.geometry.pose import distance
from envs.robots import LidarParams

from .cells import ONE
from .grid_map import GridMap
from .known_poses import KnownPoses
from .matcher import SearchParams, match_scan, search_params
from .motion_noise import NoiseRecord, motion_stds
from .observers import MatcherObserver, match_observed
from .params import TinySlamParams
from .scans import project_hits


class TinySlam(KnownPoses):
    """TinySLAM as in OSLL/tiny-slam-ros-cpp (2017), see Nguyen et al. (2025), and Steux and El Hamzaoui (2010)."""

    def __init__(self, lidar: LidarParams, params: TinySlamParams, observers: Sequence[MatcherObserver] = ()) -> None:
        """Build a SLAM for one lidar. Observers are notified of the matcher's work, which then runs in Python."""
        self.observers = tuple(observers)
        self._search = search_params(params)
        self._noise = np.empty((params.max_tries, 3))
        self._points = np.empty((2, lidar.num_beams), dtype=np.float32)
        super().__init__(lidar, params)

    def reset(self, rng: np.random.Generator, pose: Pose2D = ORIGIN, map: GridMap | None = None) -> Belief:
        """Start with an unknown map or a shared one; see `KnownPoses`. The candidates are drawn from `rng`."""
        self._odometry = pose
        return super().reset(rng, pose, map)

    def _match(self, ranges: np.ndarray, predicted: Pose2D) -> tuple[Pose2D, float | None]:
        params = self.params
        pose = predicted if self.last_key_pose is None else self._search_pose(ranges, predicted)
        return pose, params.raw_quality if pose is predicted else params.quality

    def _predict(self, motion: Pose2D) -> Pose2D:
        pose = self.belief.pose
        if self.params.odometry == "robot_frame":
            return pose.compose(motion)
        before, self._odometry = self._odometry, self._odometry.compose(motion)
        return Pose2D(
            pose.x + self._odometry.x - before.x,
            pose.y + self._odometry.y - before.y,
            wrap_angle(pose.theta + motion.theta),
        )

    def _search_pose(self, ranges: np.ndarray, predicted: Pose2D) -> Pose2D:
        """Return the pose at which the scan fits the map best; `predicted` itself if no other fits better."""
        grid_map, points, search = self.map, self._points, self._weighted_search(predicted)
        self.rng.standard_normal(out=self._noise)
        if self.observers:
            count = project_hits(ranges, grid_map.geometry, points)
            found = match_observed(self.observers, grid_map, points, count, predicted, search, self._noise)
            x, y = grid_map.to_metres(found.x, found.y)
            theta, improved = wrap_angle(found.theta), found.accepted > 0
        else:
            over = (grid_map.geometry, grid_map.words, grid_map.corner)
            x, y, theta, improved = match_scan(ranges, *over, tuple(predicted), search, self._noise, points)
        return Pose2D(x, y, theta) if improved else predicted

    def _weighted_search(self, predicted: Pose2D) -> SearchParams:
        """Return the params of the search, with the penalties that follow from the motion since the last match."""
        params, last = self.params, self._last_matched_pose()
        if params.prior_weight == 0.0 or last is None:
            return self._search
        travelled = distance(predicted.x - last.x, predicted.y - last.y)
        stds = motion_stds(NoiseRecord.of(params.odometry_noise), travelled, wrap_angle(predicted.theta - last.theta))
        weight = params.prior_weight * ONE
        return self._search._replace(
            position_penalty=weight * (params.resolution / stds[0]) ** 2, heading_penalty=weight / stds[1] ** 2
        )
