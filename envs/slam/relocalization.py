"""Relocalization: finding the pose of a robot on its own map again, as after it was kidnapped.

Scans since the loss are joined by odometry, and searched at all poses of the map by branch and bound (Hess et al.,
Real-time loop closure in 2D lidar SLAM, 2016): one scan of a short-range lidar fits in many places, ten seldom do.
"""

import math
from collections import deque
from collections.abc import Iterator

import numpy as np

from envs.geometry import OccupancyGrid, Pose2D, wrap_angle
from envs.geometry.pose import distance
from envs.robots import LidarParams

from .graph.loop_closure import LoopClosureParams, hit_shares, is_accepted
from .matching.branch_and_bound import SearchLimits, SearchWindow, angle_step, search
from .matching.pyramid import build_pyramid
from .matching.submap_field import UNKNOWN_PERCENT, FieldGeometry
from .scans import ScanGeometry, project_hits

NUM_SCANS = 10
"""Key scans that are searched together."""
LEAST_SCANS, SEARCH_EVERY, MAX_INTERVAL = 4, 2, 32
"""Key scans since the loss before the first search, and between two searches; after a search in vain twice as many as
before, up to the last number: a search costs as much as a hundred matches."""
COARSE_CELL = 0.1
"""Side of the cells of the search over the whole map [m]."""
NUM_LEVELS = 6
"""Levels of its pyramid: the top one holds maxima over 32 cells."""
MAX_POINTS, LEAST_POINTS = 300, 40
"""Points that are searched at most, one per coarse cell; with fewer than the second, nothing is."""
MAX_EVALUATIONS = 500_000
"""Nodes that a search scores at most."""
FINE_WIDTH, FINE_ANGLE = 0.2, 0.04
"""Half width [m] and half angle [rad] of the search in the map's own cells around what the coarse one found."""
NEAR = 2.0
"""Distance from the pose by odometry up to which a pose is near [m]: a robot is lost more often because its map bends
than because it was kidnapped."""
CONFIRMATIONS, FAR_CONFIRMATIONS = 3, 8
"""Searches in succession that must agree on a pose that is near, and on another one: places that look alike seldom do
for so long."""
SAME_PLACE, SAME_HEADING = 0.3, 0.1
"""By how much poses that agree differ at most [m], [rad]."""
LEAST_LEAD = 0.02
"""By how much the share of hits on occupied cells, less that on free ones, must exceed that of the next best pose."""
FOUND_STD = (0.1, 0.1, 0.03)
"""Standard deviation of a pose that was found [m, m, rad]."""
ACCEPTED = LoopClosureParams(min_score=0.45, min_occupied=0.7, max_free=0.15, min_agreement=0.8)
"""What a pose must reach; see `is_accepted`."""


class LossTracker:
    """Tells when scans in succession do not fit the map, and relocalizes the robot."""

    def __init__(self, lidar: LidarParams, lost_scans: int, is_found_by_fit: bool = False) -> None:
        """Track a SLAM for one lidar.

        Args:
            lidar: geometry of the scans.
            lost_scans: key scans in succession that do not fit, after which the robot is lost.
            is_found_by_fit: whether one scan that fits ends a loss. Else only relocalization does: sooner or later a
                scan fits where a kidnapped robot is not.
        """
        self._is_found_by_fit = is_found_by_fit
        self._geometry, self._lost_scans = ScanGeometry.of(lidar, 1.0), lost_scans
        self._points = np.empty((2, lidar.num_beams), dtype=np.float32)
        self._relocalizer = Relocalizer()
        self.reset()

    def reset(self) -> None:
        """Start with a robot that is not lost."""
        self._mismatches = 0
        self.is_found = False
        """Whether the last key scan has relocalized the robot."""
        self._relocalizer.reset()

    @property
    def is_in_doubt(self) -> bool:
        """Whether a scan has not fitted, and none has since; the robot need not be lost yet."""
        return self._mismatches > 0

    @property
    def is_lost(self) -> bool:
        """Whether scans in succession have not fitted."""
        return self._mismatches >= self._lost_scans

    def update(self, ranges: np.ndarray, predicted: Pose2D, fits: bool | None, grid: OccupancyGrid) -> Pose2D | None:
        """Process a key scan.

        A scan that does not fit is not integrated, and no scan of a lost robot is; its pose follows odometry.

        Args:
            ranges: shape (num_beams,), float32 [m].
            predicted: pose by odometry.
            fits: whether the scan fits the map; None where too little of it is known to tell.
            grid: the map.

        Returns:
            The pose to go on with, map frame, if the scan must not be integrated; None if the pose of its match is
            taken.
        """
        self.is_found = False
        if fits and (self._is_found_by_fit or not self.is_lost):
            self.reset()
            return None
        if fits is None and not self.is_in_doubt:
            return None
        self._mismatches += fits is False
        count = project_hits(ranges, self._geometry, self._points)
        self._relocalizer.add(self._points[:, :count].T.copy(), predicted)
        if not self.is_lost:
            return predicted if fits is False else None
        found = self._relocalizer.update(grid)
        if found is None:
            return predicted
        self.reset()
        self.is_found = True
        return found


class Relocalizer:
    """Collects the scans since a loss, and searches them in the map."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all scans: the robot is not lost, or no longer."""
        self._scans: deque[tuple[np.ndarray, Pose2D]] = deque(maxlen=NUM_SCANS)
        self._next, self._interval, self._count = LEAST_SCANS, SEARCH_EVERY, 0
        self._found: list[tuple[Pose2D, Pose2D]] = []

    def add(self, points: np.ndarray, pose: Pose2D) -> None:
        """Add the hits of a key scan, shape (n, 2), base frame [m], and its pose by odometry."""
        self._scans.append((points, pose))
        self._count += 1

    def update(self, grid: OccupancyGrid) -> Pose2D | None:
        """Search when it is due; return the pose at the last key scan, map frame, once searches in succession agree."""
        if self._count < self._next:
            return None
        found, by_odometry = self.search(grid), self._scans[-1][1]
        self._interval = SEARCH_EVERY if found is not None else min(2 * self._interval, MAX_INTERVAL)
        self._next = self._count + self._interval
        if found is None:
            self._found.clear()
            return None
        if self._found:
            before, there = self._found[-1]
            expected = before.compose(there.between(by_odometry))
            is_same = distance(found.x - expected.x, found.y - expected.y) <= SAME_PLACE
            if not (is_same and abs(wrap_angle(found.theta - expected.theta)) <= SAME_HEADING):
                self._found.clear()
        self._found.append((found, by_odometry))
        is_near = distance(found.x - by_odometry.x, found.y - by_odometry.y) <= NEAR
        return found if len(self._found) >= (CONFIRMATIONS if is_near else FAR_CONFIRMATIONS) else None

    def search(self, grid: OccupancyGrid) -> Pose2D | None:
        """Return the pose of the robot at the last key scan, map frame; None where no pose or more than one will do."""
        points = self._joined()
        known = np.argwhere(grid.data >= 0)
        if len(points) < LEAST_POINTS or len(known) == 0:
            return None
        (row, col), (last_row, last_col) = known.min(axis=0).tolist(), (known.max(axis=0) + 1).tolist()
        window = grid.data[row:last_row, col:last_col]
        corner = (grid.origin[0] + col * grid.resolution, grid.origin[1] + row * grid.resolution)
        field = np.where(window < 0, UNKNOWN_PERCENT, window).astype(np.uint8)
        fine = FieldGeometry(*corner, grid.resolution)
        pyramid = build_pyramid(field, fine, 3, FINE_WIDTH, UNKNOWN_PERCENT)
        around, limits = SearchWindow(FINE_WIDTH, FINE_ANGLE, 0.01), SearchLimits(0.0, MAX_EVALUATIONS)
        fits: list[tuple[float, Pose2D]] = []
        for rough in _search_everywhere(field, corner, grid.resolution, points):
            found = search(pyramid, points, rough, around, limits)
            pose = Pose2D(found.x, found.y, found.theta)
            shares = hit_shares(field, fine, points, pose)
            if found.found and is_accepted(shares, ACCEPTED):
                fits.append((shares.occupied - shares.free, pose))
        fits.sort(reverse=True)
        is_clear = len(fits) == 1 or (len(fits) > 1 and fits[0][0] >= fits[1][0] + LEAST_LEAD)
        return fits[0][1] if is_clear else None

    def _joined(self) -> np.ndarray:
        """Return the hits of all scans, one per coarse cell: shape (n, 2), float32, base frame of the last scan [m]."""
        here = self._scans[-1][1]
        parts = [here.between(pose).transform(points) for points, pose in self._scans]
        points = np.concatenate(parts).astype(np.float32)
        _, first = np.unique(np.floor(points / COARSE_CELL).astype(np.int64), axis=0, return_index=True)
        points = points[np.sort(first)]
        return np.ascontiguousarray(points[:: len(points) // MAX_POINTS + 1])


def _search_everywhere(
    field: np.ndarray, corner: tuple[float, float], resolution: float, points: np.ndarray
) -> Iterator[Pose2D]:
    """Yield the poses at which points fit a field best, one for each quarter of headings, where any will do.

    Rooms look alike from opposite sides: what is best in coarse cells need not be in fine ones.
    """
    block = max(1, round(COARSE_CELL / resolution))
    rows, cols = (math.ceil(size / block) for size in field.shape)
    padded = np.zeros((rows * block, cols * block), dtype=np.uint8)
    padded[: field.shape[0], : field.shape[1]] = field
    coarse = np.ascontiguousarray(padded.reshape(rows, block, cols, block).max(axis=(1, 3)))
    geometry = FieldGeometry(*corner, block * resolution)
    reach = 0.5 * max(rows, cols) * geometry.resolution
    pyramid = build_pyramid(coarse, geometry, NUM_LEVELS, reach, UNKNOWN_PERCENT)
    x, y = corner[0] + 0.5 * cols * geometry.resolution, corner[1] + 0.5 * rows * geometry.resolution
    window = SearchWindow(reach, 0.25 * math.pi, angle_step(points, geometry.resolution))
    limits = SearchLimits(ACCEPTED.min_score, MAX_EVALUATIONS)
    for heading in (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi):
        found = search(pyramid, points, Pose2D(x, y, heading), window, limits)
        if found.found:
            yield Pose2D(found.x, found.y, found.theta)
