"""TinySLAM: match each scan to the map by Monte Carlo search, then integrate it."""

import math
from collections.abc import Sequence

import numpy as np

from envs.estimation import NO_UPDATE, ORIGIN, Belief
from envs.geometry import Pose2D, wrap_angle
from envs.robots import LidarParams

from .grid_map import GridMap, has_moved
from .matcher import match, project_hits
from .observers import MatcherObserver
from .params import TinySlamParams


class TinySlam:
    """TinySLAM as in OSLL/tiny-slam-ros-cpp (2017), see Nguyen et al. (2025), and Steux and El Hamzaoui (2010)."""

    shares_maps = True
    """Whether several robots may integrate their scans into one map."""

    def __init__(self, lidar: LidarParams, params: TinySlamParams, observers: Sequence[MatcherObserver] = ()) -> None:
        """Build a SLAM for one lidar.

        Args:
            lidar: geometry of the scans.
            params: what to do with them.
            observers: are notified of the matcher's work; recording it costs time only where there are any.
        """
        self.params = params
        self.observers = tuple(observers)
        self._lidar = lidar
        self._noise = np.empty((params.max_tries, 3))
        self._points = np.empty((2, lidar.num_beams), dtype=np.float32)
        self._record = np.empty((params.max_tries + 1 if self.observers else 0, 5))
        self.reset(np.random.default_rng(0))

    @property
    def belief(self) -> Belief:
        """The current belief."""
        return self._belief

    def reset(self, rng: np.random.Generator, pose: Pose2D = ORIGIN, map: GridMap | None = None) -> Belief:
        """Start with an unknown map, or with one that other robots integrate their scans into as well.

        Args:
            rng: source of the candidates.
            pose: known pose of the robot, map frame.
            map: the shared map; None for an unknown one.
        """
        self.rng = rng
        self.map = GridMap(self.params, self._lidar) if map is None else map
        self.last_integrated_pose: Pose2D | None = None
        self._odometry = pose
        self._belief = Belief(pose, self.map.grid)
        return self._belief

    def update(self, ranges: np.ndarray, motion: Pose2D) -> Belief:
        """Process one scan.

        Args:
            ranges: shape (num_beams,), float32 [m]: +inf for no return, NaN for a beam to ignore.
            motion: pose of the base now, as odometry sees it from the base at the previous scan.

        Raises:
            ValueError: if the scan has another number of beams, or the motion is not finite.
        """
        ranges, params, belief = check_scan(ranges, motion, self._lidar), self.params, self._belief
        predicted, last = self._predict(motion), self.last_integrated_pose
        belief.pose = predicted if last is None else self._match(ranges, predicted)
        belief.update = NO_UPDATE
        if last is None or has_moved(*last, *belief.pose, params.min_travel_distance, params.min_travel_angle):
            quality = params.raw_quality if belief.pose is predicted else params.quality
            belief.update = self.map.integrate(ranges, belief.pose, quality)
            self.last_integrated_pose = belief.pose
        return belief

    def _predict(self, motion: Pose2D) -> Pose2D:
        pose = self._belief.pose
        if self.params.odometry == "robot_frame":
            return pose.compose(motion)
        before, self._odometry = self._odometry, self._odometry.compose(motion)
        return Pose2D(
            pose.x + self._odometry.x - before.x,
            pose.y + self._odometry.y - before.y,
            wrap_angle(pose.theta + motion.theta),
        )

    def _match(self, ranges: np.ndarray, predicted: Pose2D) -> Pose2D:
        """Return the pose at which the scan fits the map best; `predicted` itself if no other fits better."""
        params, grid_map, mount = self.params, self.map, self._lidar.mount
        count = project_hits(
            ranges, self._lidar.range_max, grid_map.directions, mount.x, mount.y, params.resolution, self._points
        )
        self.rng.standard_normal(out=self._noise)
        x, y, theta, cost, accepted, tried = match(
            grid_map.words,
            self._points,
            count,
            grid_map.unvisited,
            *grid_map.to_cells(predicted.x, predicted.y),
            predicted.theta,
            params.sigma_xy / params.resolution,
            params.sigma_theta,
            params.max_failed,
            params.max_tries,
            self._noise,
            self._record,
        )
        pose = Pose2D(*grid_map.to_metres(x, y), wrap_angle(theta)) if accepted else predicted
        if self.observers:
            self._tell(predicted, pose, cost, tried)
        return pose

    def _tell(self, predicted: Pose2D, pose: Pose2D, cost: float, tried: int) -> None:
        """Replay the search to the observers."""
        for observer in self.observers:
            observer.on_matching_start(predicted)
            for k, (x, y, theta, tested_cost, accepted) in enumerate(self._record[: tried + 1].tolist()):
                tested = Pose2D(*self.map.to_metres(x, y), wrap_angle(theta)) if k else predicted
                observer.on_scan_test(tested, tested_cost)
                if accepted and k:
                    observer.on_pose_update(tested, tested_cost)
            observer.on_matching_end(pose, cost)


def check_scan(ranges: np.ndarray, motion: Pose2D, lidar: LidarParams) -> np.ndarray:
    """Return `ranges` as float32.

    Raises:
        ValueError: if the scan has another number of beams than the lidar, or the motion is not finite.
    """
    ranges = np.asarray(ranges, dtype=np.float32)
    if ranges.shape != (lidar.num_beams,):
        raise ValueError(f"ranges must have shape ({lidar.num_beams},), as the lidar has beams, got {ranges.shape}")
    if not math.isfinite(motion[0] + motion[1] + motion[2]):
        raise ValueError(f"motion must be finite, got {tuple(motion)}")
    return ranges
