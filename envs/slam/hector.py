import numpy as np

from lidarnaut.envs.estimation import Belief, MapUpdate
from lidarnaut.envs.geometry import ORIGIN, Pose2D
from lidarnaut.envs.robots import LidarParams

from .key_scans import KeyScanSlam
from .log_odds_map import LogOddsMap
from .matching.covariance import position_std
from .matching.scan_matcher import Match, MatcherParams, match_to_levels
from .relocalization import FOUND_STD, LocalizationMonitor
from .slam_params import HectorParams

MIN_SCORE_WITH_PEOPLE = 0.5
"""Minimum mean occupancy of known cells at the scan points for a scan to fit the map when people are near."""


class Hector(KeyScanSlam):
    """SLAM by Gauss-Newton scan matching on one map (Kohlbrecher et al., A flexible and scalable SLAM system, 2011).

    Unlike in the paper, odometry is a weighted pose prior, unless `uses_odometry=False`. Loops are not closed.
    `belief.is_lost` is set after consecutive scans that do not fit the map, or at high position uncertainty. Such scans
    are not inserted. A lost robot is searched on the whole map.
    """

    params: HectorParams
    map: LogOddsMap

    def __init__(self, lidar: LidarParams, params: HectorParams) -> None:
        self._matcher = MatcherParams.of(params)
        self._monitor = LocalizationMonitor(params.limited(lidar), has_odometry=params.uses_odometry)
        super().__init__(lidar, params)

    def reset(self, rng: np.random.Generator, pose: Pose2D = ORIGIN, map: LogOddsMap | None = None) -> Belief:
        self._monitor.reset()
        self._monitor.meets_people = self.meets_people
        if self.meets_people:  # mismatches near people are expected
            self._matcher = self._matcher._replace(retry_below=0.0, min_known_score=MIN_SCORE_WITH_PEOPLE)
        return super().reset(rng, pose, map)

    def make_map(self) -> LogOddsMap:
        return LogOddsMap(self.params, self._lidar)

    def _integrate(self, ranges: np.ndarray, pose: Pose2D, quality: float) -> MapUpdate:
        return self.map.integrate(ranges, pose)

    def match(self, ranges: np.ndarray, predicted: Pose2D) -> tuple[Pose2D, float | None]:
        if self.last_key_pose is None:
            return predicted, 1.0
        match = self._match_map(ranges, predicted)
        pose = Pose2D(match.x, match.y, match.theta)
        fallback_pose = self._update_lost(ranges, predicted, pose, match.fits if match.is_judged else None)
        return (pose, 1.0) if fallback_pose is None else (fallback_pose, None)

    def _match_map(self, ranges: np.ndarray, predicted: Pose2D) -> Match:
        last, belief = self._last_matched_pose() or predicted, self.belief
        # Earlier beliefs keep their covariance.
        belief.covariance = belief.covariance.copy()
        over = (self.map.geometry, self.map.levels, self.map.sums, self.map.corner)
        poses = (tuple(last), tuple(predicted))
        matcher = self._matcher.in_contact(self.slip)
        tested: list[Match] = []
        for steps in range(matcher.iterations) if self.observers else ():
            less, covariance = matcher._replace(iterations=steps, retry_below=0.0), belief.covariance.copy()
            tested.append(match_to_levels(ranges, *over, *poses, less, covariance, self._points))
        match: Match = match_to_levels(ranges, *over, *poses, matcher, belief.covariance, self._points)
        costs = [(Pose2D(*each[:3]), each.num_hits - each.fit.total) for each in (*tested, match)]
        for observer in self.observers:
            observer(predicted, costs, costs[-1])
        return match

    def _update_lost(self, ranges: np.ndarray, predicted: Pose2D, pose: Pose2D, fits: bool | None) -> Pose2D | None:
        belief = self.belief
        fallback_pose = self._monitor.update(ranges, predicted, pose, fits, belief.grid)
        if self._monitor.is_found:
            belief.covariance = np.diag(FOUND_STD) ** 2
        belief.is_lost = self._monitor.is_lost or position_std(belief.covariance) > self.params.max_position_std
        return fallback_pose
