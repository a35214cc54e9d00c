from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import NO_UPDATE, Belief, Estimator, MapUpdate
from lidarnaut.envs.estimation.scan_points import ScanGeometry, project_hits
from lidarnaut.envs.geometry import ORIGIN, GrowingArray, OccupancyGrid, Pose2D, distance, wrap_angle
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.simulation import Reading

from .grid_map import GridMap
from .log_odds_map import LOG_ODDS_UNIT, LogOddsMap
from .matcher import MatcherObserver
from .scans import check_scan, median_ranges
from .slam_params import load_params


@njit(cache=True, error_model="numpy")
def has_moved(x, y, theta, new_x, new_y, new_theta, min_distance, min_angle):
    """Return True if two poses [m, m, rad] differ by at least `min_distance` [m] or `min_angle` [rad]."""
    return distance(new_x - x, new_y - y) >= min_distance or abs(wrap_angle(new_theta - theta)) >= min_angle


MAX_LOG_ODDS_WITH_PEOPLE = 3.5
"""Maximum log-odds of map cells among people (Hornung et al., "OctoMap", 2013, section 3.4). Nine free observations
clear a cell."""
POINT_CELL = 0.1
"""Cell side for thinning merged scans to one point per cell [m]."""


class KeyScans:
    """Store of lidar scans and base poses."""

    def __init__(self, lidar: LidarParams) -> None:
        self._geometry = ScanGeometry.of(lidar)
        self._ranges = GrowingArray((lidar.num_beams,), np.float32, 256)
        self._poses = GrowingArray((3,), np.float64, 256)

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def ranges(self) -> np.ndarray:
        return self._ranges.rows

    @property
    def poses(self) -> np.ndarray:
        """Base poses of the scans, without later corrections, shape (n, 3), float64 [m, m, rad]."""
        return self._poses.rows

    def add(self, ranges: np.ndarray, pose: Pose2D) -> int:
        """Store a scan, shape (num_beams,), float32 [m], at a base pose; return its index."""
        self._ranges.append(ranges)
        return self._poses.append(pose)

    def joined_points(self, first: int, last: int, max_range: float, max_points: int) -> np.ndarray:
        """Merge the points of scans `first` to `last`, shape (n, 2), float32, base frame of scan `last` [m].

        Points within `max_range` [m] are thinned to one per cell of side `POINT_CELL`, and to `max_points`.
        """
        here, found, parts = Pose2D(*self.poses[last].tolist()), np.empty((2, self.ranges.shape[1]), np.float32), []
        for ranges, pose in zip(self.ranges[first : last + 1], self.poses[first : last + 1].tolist()):
            count = project_hits(ranges, self._geometry, found)
            parts.append(here.between(Pose2D(*pose)).transform(found[:, :count].T))
        points = np.concatenate(parts).astype(np.float32)
        points = points[(points**2).sum(axis=1) < max_range**2]
        cells = np.floor(points / POINT_CELL).astype(np.int64)
        _, chosen = np.unique((cells[:, 0] << 32) + cells[:, 1], return_index=True)
        points = points[np.sort(chosen)]
        return np.ascontiguousarray(points[:: len(points) // max_points + 1])


class KeyScanSlam(Estimator, ABC):
    """SLAM that matches and maps key scans (scans after a minimum motion); between them, the pose follows odometry.

    Subclasses define `match`. The minimum motion is `params.min_travel_distance` or `params.min_travel_angle`. With
    `params.match_every_scan`, all scans are matched, but only key scans are inserted into the map.
    """

    meets_people = False
    """Whether the robot tracks people; log-odds of map cells are then limited to `MAX_LOG_ODDS_WITH_PEOPLE`."""
    unmatched: np.ndarray | None = None
    """Beams to exclude from the next scan matching but not from mapping, shape (num_beams,), bool; None for none."""
    observers: Sequence[MatcherObserver] = ()
    """Functions that receive the poses tested in scan matching."""
    slip = 0.0
    """Distance by odometry [m] while the bumper was pressed, since the last processed scan; wheels slip in contact."""
    shares_maps = True

    def __init__(self, lidar: LidarParams, params: Any) -> None:
        """Create a SLAM; `params`: parameters, or the side of a map cell [m] for the defaults of TinySLAM."""
        is_resolution = isinstance(params, (int, float))
        self.params: Any = load_params("default", {"resolution": params}) if is_resolution else params
        params = self.params
        self._lidar = params.limited(lidar)
        self._points = np.empty((2, lidar.num_beams), dtype=np.float32)
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator, pose: Pose2D = ORIGIN, map: Any = None) -> Belief:
        """Restart at a known pose, map frame, with a new map, or with a given shared map.

        Raises:
            ValueError: if a map is given, but the SLAM cannot share maps.
        """
        if map is not None and not self.shares_maps:
            raise ValueError(f"{type(self).__name__} cannot continue a given map")
        self.rng, self.slip = rng, 0.0
        self.map = self.make_map() if map is None else map
        if self.meets_people and isinstance(self.map, LogOddsMap):
            bound = min(self.map.model.bound, round(MAX_LOG_ODDS_WITH_PEOPLE * LOG_ODDS_UNIT))
            self.map.model = self.map.model._replace(bound=bound)
        self.last_key_pose: Pose2D | None = None
        """Base pose at the last key scan (scan after a minimum motion), map frame; None before the first."""
        grid: OccupancyGrid = self.map.grid
        self.belief = Belief(pose, grid)
        return self.belief

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Update pose and map by a lidar scan; +inf in `reading.ranges` means no return, NaN an ignored beam.

        `motion`: odometry since the previous scan.

        Raises:
            ValueError: if the number of beams is wrong, or the motion is not finite.
        """
        ranges = check_scan(reading.ranges, motion, self._lidar)
        predicted = self.predict(motion)
        if reading.bumper:
            self.slip += distance(motion.x, motion.y)
        if self.params.match_every_scan or self.is_key_pose(predicted):
            return self.process_key_scan(ranges, predicted)
        self.belief.pose, self.belief.update = predicted, NO_UPDATE
        return self.belief

    @property
    def follows_odometry(self) -> bool:  # type: ignore[override]
        return not self.params.match_every_scan

    def is_key_pose(self, pose: Pose2D) -> bool:
        last, params = self.last_key_pose, self.params
        return last is None or has_moved(*last, *pose, params.min_travel_distance, params.min_travel_angle)

    def process_key_scan(self, ranges: np.ndarray, predicted: Pose2D) -> Belief:
        """Match a scan, shape (num_beams,), float32 [m], to the map and insert it; `predicted` is the odometry pose."""
        belief = self.belief
        if self.params.median_width > 0.0:
            ranges = median_ranges(ranges, self._lidar.angle_increment, self.params.median_width)
        matched = ranges if self.unmatched is None else np.where(self.unmatched, np.float32(np.nan), ranges)
        pose, quality = self.match(matched, predicted)
        belief.pose, belief.update = pose, NO_UPDATE
        if not self.params.match_every_scan or self.is_key_pose(pose):
            if quality is not None:
                belief.update = self._integrate(ranges, pose, quality)
            self.last_key_pose = pose
        self.slip = 0.0
        return belief

    def predict(self, motion: Pose2D) -> Pose2D:
        """Return the pose after a motion by odometry."""
        return self.belief.pose.compose(motion)

    def _last_matched_pose(self) -> Pose2D | None:
        return self.belief.pose if self.params.match_every_scan and self.last_key_pose else self.last_key_pose

    def _integrate(self, ranges: np.ndarray, pose: Pose2D, quality: float) -> MapUpdate:
        update: MapUpdate = self.map.integrate(ranges, pose, quality)
        return update

    def make_map(self) -> Any:
        """Return a new, unknown map; by default that of TinySLAM."""
        return GridMap(self.params, self._lidar)

    @abstractmethod
    def match(self, ranges: np.ndarray, predicted: Pose2D) -> tuple[Pose2D, float | None]:
        """Match a scan; return the pose, map frame, and the scan's weight in the map (0 to 1), None to skip mapping."""
