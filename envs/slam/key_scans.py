"""What all SLAMs here share: which scans are matched and integrated, which are passed over, and which are kept."""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from lidarnaut.envs.estimation import NO_UPDATE, ORIGIN, Belief, MapUpdate
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D, wrap_angle
from lidarnaut.envs.geometry.pose import distance
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.simulation import Reading

from .log_odds_map import ONE, LogOddsMap
from .posegraph import GrowingArray
from .scans import ScanGeometry, check_scan, project_hits


@njit(cache=True, error_model="numpy")
def has_moved(x, y, theta, new_x, new_y, new_theta, min_distance, min_angle):
    """Tell whether two poses are `min_distance` [m] or `min_angle` [rad] or more apart."""
    return distance(new_x - x, new_y - y) >= min_distance or abs(wrap_angle(new_theta - theta)) >= min_angle


FADING = 3.5
"""Largest log odds of a cell where people walk (Hornung et al., "OctoMap", 2013, section 3.4): nine scans that see
nobody there are enough to clear it."""
POINT_CELL = 0.1
"""Side of the cells of which each gives one point when scans are searched in a map [m]."""


class Anchor(NamedTuple):
    """A pose by that of a key scan, with which corrections move it."""

    key_scan: int
    """Row of `Belief.path`."""
    relative: Pose2D
    """The pose as seen from the key scan."""


class KeyScans:
    """Scans that are kept, and where they were taken."""

    def __init__(self, lidar: LidarParams) -> None:
        """Make an empty store for scans of a lidar."""
        self._geometry = ScanGeometry.of(lidar, 1.0)
        self._ranges = GrowingArray((lidar.num_beams,), np.float32, 256)
        self._poses = GrowingArray((3,), np.float64, 256)

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def ranges(self) -> np.ndarray:
        """Shape (n, num_beams), float32: the scans [m]."""
        return self._ranges.rows

    @property
    def poses(self) -> np.ndarray:
        """Shape (n, 3), float64: poses of the base by scan matching or odometry, never corrected [m, m, rad]."""
        return self._poses.rows

    def add(self, ranges: np.ndarray, pose: Pose2D) -> int:
        """Add a scan, shape (num_beams,), float32 [m], taken at a pose of the base; return its index."""
        self._ranges.append(ranges)
        return self._poses.append(pose)

    def points(self, index: int) -> np.ndarray:
        """Return the hits of a scan, shape (n, 2), float32, base frame [m]."""
        out = np.empty((2, self.ranges.shape[1]), dtype=np.float32)
        count = project_hits(self.ranges[index], self._geometry, out)
        return out[:, :count].T

    def joined_points(self, first: int, last: int, max_range: float, max_points: int) -> np.ndarray:
        """Return the hits of scans `first` to `last` as seen from the last one, one for each `POINT_CELL`.

        Shape (n, 2), float32 [m]; n is at most `max_points`, evenly chosen, and none is farther than `max_range` [m].
        """
        here = Pose2D(*self.poses[last].tolist())
        poses = [Pose2D(*pose) for pose in self.poses[first : last + 1].tolist()]
        parts = [here.between(pose).transform(self.points(first + k)) for k, pose in enumerate(poses)]
        points = np.concatenate(parts).astype(np.float32)
        points = points[(points**2).sum(axis=1) < max_range**2]
        cells = np.floor(points / POINT_CELL).astype(np.int64)
        _, chosen = np.unique((cells[:, 0] << 32) + cells[:, 1], return_index=True)
        points = points[np.sort(chosen)]
        return np.ascontiguousarray(points[:: len(points) // max_points + 1])


class KeyScanSlam(ABC):
    """Matches and integrates key scans; between them the pose follows odometry.

    A scan is a key scan if the pose predicted by odometry is `params.min_travel_distance` or `params.min_travel_angle`
    away from that of the last key scan. With `params.match_every_scan`, every scan is matched, and those whose matched
    poses lie that far apart are integrated. What `process_key_scan` does follows from its arguments and from what the
    last key scan left: a simulation may compose the motions by itself, and call it at the key scans alone.
    """

    meets_people = False
    """Whether what the map shows may leave, so that evidence for it is bounded by `FADING`."""
    unmatched: np.ndarray | None = None
    """Shape (num_beams,), bool: beams of the next scan that are integrated, and not matched; None for none."""
    shares_maps = True
    """Whether several robots may integrate their scans into one map."""

    def __init__(self, lidar: LidarParams, params: Any) -> None:
        """Build a SLAM for one lidar, with params that are `SlamParams` and tell whether to `match_every_scan`."""
        self.params = params
        self._lidar = lidar
        self._points = np.empty((2, lidar.num_beams), dtype=np.float32)
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator, pose: Pose2D = ORIGIN, map: Any = None) -> Belief:
        """Start at a known pose, map frame, with an unknown map or one that other robots integrate into as well."""
        self.rng = rng
        self.map = self._make_map() if map is None else map
        if self.meets_people and isinstance(self.map, LogOddsMap):
            bound = min(self.map.model.bound, round(FADING * ONE))
            self.map.model = self.map.model._replace(bound=bound)
        self.last_key_pose: Pose2D | None = None
        """Pose of the last key scan; None before the first."""
        grid: OccupancyGrid = self.map.grid
        self.belief = Belief(pose, grid)
        return self.belief

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Process the scan of a reading, in whose `ranges` +inf is no return, NaN a beam to ignore.

        `motion`: pose of the base now, as the motion source sees it from the base at the previous scan. ValueError if
        the scan has another number of beams, or the motion is not finite.
        """
        ranges = check_scan(reading.ranges, motion, self._lidar)
        predicted = self._predict(motion)
        if self.params.match_every_scan or self.is_key_pose(predicted):
            return self.process_key_scan(ranges, predicted)
        self.belief.pose, self.belief.update = predicted, NO_UPDATE
        return self.belief

    def is_key_pose(self, pose: Pose2D) -> bool:
        """Tell whether a pose is far enough from that of the last key scan for another one."""
        last, params = self.last_key_pose, self.params
        return last is None or has_moved(*last, *pose, params.min_travel_distance, params.min_travel_angle)

    def process_key_scan(self, ranges: np.ndarray, predicted: Pose2D) -> Belief:
        """Match a scan, shape (num_beams,), float32 [m], and integrate it.

        The predicted pose, map frame, follows odometry since the last key scan, or since the last scan if every scan is
        matched.
        """
        belief = self.belief
        matched = ranges if self.unmatched is None else np.where(self.unmatched, np.float32(np.nan), ranges)
        pose, quality = self._match(matched, predicted)
        belief.pose, belief.update = pose, NO_UPDATE
        if not self.params.match_every_scan or self.is_key_pose(pose):
            if quality is not None:
                belief.update = self._integrate(ranges, pose, quality)
            self.last_key_pose = pose
        return belief

    def _predict(self, motion: Pose2D) -> Pose2D:
        """Return the pose after a motion."""
        return self.belief.pose.compose(motion)

    def _last_matched_pose(self) -> Pose2D | None:
        """Return the pose of the last scan that was matched, while the next one is; None before the first."""
        return self.belief.pose if self.params.match_every_scan and self.last_key_pose else self.last_key_pose

    def _integrate(self, ranges: np.ndarray, pose: Pose2D, quality: float) -> MapUpdate:
        update: MapUpdate = self.map.integrate(ranges, pose, quality)
        return update

    @abstractmethod
    def _make_map(self) -> Any:
        """Return an unknown map, with `grid` and `integrate`."""

    @abstractmethod
    def _match(self, ranges: np.ndarray, predicted: Pose2D) -> tuple[Pose2D, float | None]:
        """Return the pose at which a scan fits, and its weight in the map from 0 to 1; None not to integrate it."""
