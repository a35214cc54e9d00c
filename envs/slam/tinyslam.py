import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.estimation.scan_points import project_hits
from lidarnaut.envs.geometry import ORIGIN, Pose2D, distance, wrap_angle
from lidarnaut.envs.robots import LidarParams

from .grid_map import FULL_OCCUPANCY, GridMap, unvisited_word
from .key_scans import KeyScanSlam
from .matcher import SearchParams, match_scan
from .matching.correlative import search_window
from .matching.covariance import NoiseRecord, motion_stds
from .matching.gauss_newton import known_score_at
from .relocalization import LocalizationMonitor
from .slam_params import TinySlamParams

WIDE_SPREAD = (0.3, 0.2)
"""Standard deviations of sampled positions [m] and headings [rad] in a second, wider search after a poor match."""
LEAST_KNOWN_HITS, LEAST_KNOWN_SCORE, LEAST_WIDE_SCORE = 20, 0.25, 0.7
"""Test whether a scan fits the map: minimum number of scan points in known cells, minimum mean occupancy of these
cells, and higher minimum after a second, wider search."""


class KnownPoses(KeyScanSlam):
    """Mapping without scan matching: scans are inserted at odometry or ground-truth poses."""

    params: TinySlamParams
    map: GridMap

    def match(self, ranges: np.ndarray, predicted: Pose2D) -> tuple[Pose2D, float | None]:
        return predicted, self.params.quality

    @property
    def follows_odometry(self) -> bool:  # type: ignore[override]
        return True


class TinySlam(KeyScanSlam):
    """SLAM by Monte Carlo scan matching on one map (Steux and El Hamzaoui, tinySLAM, 2010).

    Further sources: OSLL/tiny-slam-ros-cpp (2017); Nguyen et al. (2025). If only scans after a minimum motion are
    matched, `belief.is_lost` is set after consecutive scans that do not fit the map. Such scans are not inserted. A
    lost robot is searched on the whole map.
    """

    params: TinySlamParams
    map: GridMap

    def __init__(self, lidar: LidarParams, params: TinySlamParams) -> None:
        limits = params.max_failed, params.max_tries, unvisited_word(params.unvisited)
        self._search = SearchParams(params.sigma_xy / params.resolution, params.sigma_theta, *limits)
        self._wide_search = self._search._replace(
            sigma_xy=WIDE_SPREAD[0] / params.resolution, sigma_theta=WIDE_SPREAD[1]
        )
        self._monitor = LocalizationMonitor(params.limited(lidar))
        self._noise, self._trace = np.empty((params.max_tries, 3)), np.empty((params.max_tries + 1, 5))
        super().__init__(lidar, params)

    def reset(self, rng: np.random.Generator, pose: Pose2D = ORIGIN, map: GridMap | None = None) -> Belief:
        self._odometry = pose
        self._monitor.reset()
        return super().reset(rng, pose, map)

    def match(self, ranges: np.ndarray, predicted: Pose2D) -> tuple[Pose2D, float | None]:
        params = self.params
        if self.last_key_pose is None:
            return predicted, params.raw_quality
        pose = self._search_pose(ranges, predicted)
        if not params.match_every_scan:
            fits, belief = self._fits(ranges, pose), self.belief
            if fits is False:
                wide = self._search_pose(ranges, predicted, self._wide_search)
                if self._fits(ranges, wide, LEAST_WIDE_SCORE):
                    pose, fits = wide, True
            fallback_pose = self._monitor.update(ranges, predicted, pose, fits, belief.grid)
            belief.is_lost = self._monitor.is_lost
            if fallback_pose is not None:
                return fallback_pose, None
        return pose, params.raw_quality if pose is predicted else params.quality

    def _fits(self, ranges: np.ndarray, pose: Pose2D, least_score: float = LEAST_KNOWN_SCORE) -> bool | None:
        count = project_hits(ranges, self.map.geometry, self._points)
        x, y = self.map.to_cells(pose.x, pose.y)
        num_known, score = known_score_at((self.map.grid.data,), self._points, count, x, y, pose.theta)
        return score >= least_score if num_known >= LEAST_KNOWN_HITS else None

    @property
    def follows_odometry(self) -> bool:  # type: ignore[override]
        return super().follows_odometry and bool(self.params.odometry == "robot_frame")

    def predict(self, motion: Pose2D) -> Pose2D:
        pose = self.belief.pose
        if self.params.odometry == "robot_frame":
            return pose.compose(motion)
        before, self._odometry = self._odometry, self._odometry.compose(motion)
        x, y = pose.x + self._odometry.x - before.x, pose.y + self._odometry.y - before.y
        return Pose2D(x, y, wrap_angle(pose.theta + motion.theta))

    def _search_pose(self, ranges: np.ndarray, predicted: Pose2D, search: SearchParams | None = None) -> Pose2D:
        start = predicted
        if search is None:
            search = self._weighted_search(predicted)
            if self.slip > self.params.resolution:
                start = self._search_window(ranges, predicted)
            if self.slip > 0.0:
                search = search._replace(sigma_xy=max(search.sigma_xy, 0.5))
        self.rng.standard_normal(out=self._noise)
        over = (self.map.geometry, self.map.words, self.map.corner, tuple(start))
        work = (search, self._noise, self._points, self._trace)
        pose, num_tried, is_better, num_hits = match_scan(ranges, *over, *work)
        if self.observers:
            rows, to_metres = self._trace[: num_tried + 1].tolist(), self.map.to_metres
            poses = [start, *(Pose2D(*to_metres(x, y), wrap_angle(theta)) for x, y, theta, _, _ in rows[1:])]
            costs = [num_hits - row[3] / FULL_OCCUPANCY for row in rows]
            tested = list(zip(poses, costs))
            for observer in self.observers:
                observer(start, tested, min(tested, key=lambda one: one[1]))
        return Pose2D(*pose) if is_better else start

    def _search_window(self, ranges: np.ndarray, predicted: Pose2D) -> Pose2D:
        count, std = project_hits(ranges, self.map.geometry, self._points), self.slip / self.params.resolution
        start = *self.map.to_cells(predicted.x, predicted.y), predicted.theta
        x, y, theta = search_window(self.map.grid.data, 1.0, self._points, count, start, (std, 0.0), 50)
        return Pose2D(*self.map.to_metres(x, y), wrap_angle(theta))

    def _weighted_search(self, predicted: Pose2D) -> SearchParams:
        params, last = self.params, self._last_matched_pose()
        if params.prior_weight == 0.0 or last is None:
            return self._search
        travelled = distance(predicted.x - last.x, predicted.y - last.y)
        noise = NoiseRecord.of(params.odometry_noise).in_contact(self.slip)
        stds = motion_stds(noise, travelled, wrap_angle(predicted.theta - last.theta))
        weight = params.prior_weight * FULL_OCCUPANCY
        position_penalty = weight * (params.resolution / stds[0]) ** 2
        return self._search._replace(position_penalty=position_penalty, heading_penalty=weight / stds[1] ** 2)
