"""Relocalization: finding the pose of a robot on its own map again, as after it was kidnapped.

Scans since the loss are joined by odometry, and searched at all poses of the map by branch and bound (Hess et al.,
Real-time loop closure in 2D lidar SLAM, 2016): one scan of a short-range lidar fits in many places, ten seldom do.
"""

import math
from collections.abc import Iterator

import numpy as np

from envs.geometry import OccupancyGrid, Pose2D
from envs.geometry.pose import distance
from envs.robots import LidarParams

from .key_scans import KeyScans, has_moved
from .matching.branch_and_bound import SearchWindow, angle_step, search
from .matching.fields import Field, build_pyramid, hit_shares, is_accepted
from .params import LoopClosureParams

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
"""Points that are searched at most; with fewer than the second, nothing is."""
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
        """Track a SLAM for one lidar; the robot is lost after `lost_scans` key scans in succession that do not fit.

        Where `is_found_by_fit`, one scan that fits ends a loss. Else only relocalization does: sooner or later a scan
        fits where a kidnapped robot is not.
        """
        self._is_found_by_fit, self._lost_scans = is_found_by_fit, lost_scans
        self._relocalizer = Relocalizer(lidar)
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
        """Process a key scan, shape (num_beams,), float32 [m], at a pose predicted by odometry.

        A scan that does not fit is not integrated, and no scan of a lost robot is; its pose follows odometry. `fits` is
        None where too little of the map, `grid`, is known to tell. Returns the pose to go on with, map frame, if the
        scan must not be integrated; None if the pose of its match is taken.
        """
        self.is_found = False
        if fits and (self._is_found_by_fit or not self.is_lost):
            if self.is_in_doubt:
                self.reset()
            return None
        if fits is None and not self.is_in_doubt:
            return None
        self._mismatches += fits is False
        found = self._relocalizer.update(ranges, predicted, grid if self.is_lost else None)
        if not self.is_lost:
            return predicted if fits is False else None
        if found is None:
            return predicted
        self.reset()
        self.is_found = True
        return found


class Relocalizer:
    """Collects the scans since a loss, and searches them in the map."""

    def __init__(self, lidar: LidarParams) -> None:
        """Start without scans of a lidar."""
        self._lidar = lidar
        self.reset()

    def reset(self) -> None:
        """Forget all scans: the robot is not lost, or no longer."""
        self._scans = KeyScans(self._lidar)
        self._next, self._interval = LEAST_SCANS, SEARCH_EVERY
        self._found: list[tuple[Pose2D, Pose2D]] = []

    def update(self, ranges: np.ndarray, pose: Pose2D, grid: OccupancyGrid | None) -> Pose2D | None:
        """Add a key scan, shape (num_beams,), float32 [m], and its pose by odometry; search the map when it is due.

        Without a map nothing is searched. Returns the pose of the scan, map frame, once searches in succession agree.
        """
        self._scans.add(ranges, pose)
        if grid is None or len(self._scans) < self._next:
            return None
        found = self.search(grid)
        self._interval = SEARCH_EVERY if found is not None else min(2 * self._interval, MAX_INTERVAL)
        self._next = len(self._scans) + self._interval
        if found is None:
            self._found.clear()
            return None
        if self._found:
            before, there = self._found[-1]
            if has_moved(*before.compose(there.between(pose)), *found, SAME_PLACE, SAME_HEADING):
                self._found.clear()
        self._found.append((found, pose))
        is_near = distance(found.x - pose.x, found.y - pose.y) <= NEAR
        return found if len(self._found) >= (CONFIRMATIONS if is_near else FAR_CONFIRMATIONS) else None

    def search(self, grid: OccupancyGrid) -> Pose2D | None:
        """Return the pose of the robot at the last key scan, map frame; None where no pose or more than one will do."""
        last = len(self._scans) - 1
        points = self._scans.joined_points(max(last + 1 - NUM_SCANS, 0), last, math.inf, MAX_POINTS)
        if len(points) < LEAST_POINTS:
            return None
        field = Field.of(grid)
        pyramid = build_pyramid(field, 3, FINE_WIDTH)
        around = SearchWindow(FINE_WIDTH, FINE_ANGLE, 0.01)
        fits: list[tuple[float, Pose2D]] = []
        for rough in _search_everywhere(field, points):
            pose = search(pyramid, points, rough, around, 0.0, MAX_EVALUATIONS).pose
            if pose is not None and is_accepted(shares := hit_shares(field, points, pose), ACCEPTED):
                fits.append((shares.occupied - shares.free, pose))
        fits.sort(reverse=True)
        is_clear = len(fits) == 1 or (len(fits) > 1 and fits[0][0] >= fits[1][0] + LEAST_LEAD)
        return fits[0][1] if is_clear else None


def _search_everywhere(field: Field, points: np.ndarray) -> Iterator[Pose2D]:
    """Yield the poses at which points fit a field best, one for each quarter of headings, where any will do.

    Rooms look alike from opposite sides: what is best in coarse cells need not be in fine ones.
    """
    block = max(1, round(COARSE_CELL / field.resolution))
    height, width = field.occupancy.shape
    padded = np.pad(field.occupancy, ((0, -height % block), (0, -width % block)), constant_values=-1)
    rows, cols = padded.shape[0] // block, padded.shape[1] // block
    coarse = np.ascontiguousarray(padded.reshape(rows, block, cols, block).max(axis=(1, 3)))
    side = block * field.resolution
    reach = 0.5 * max(rows, cols) * side
    pyramid = build_pyramid(Field(coarse, field.x, field.y, side), NUM_LEVELS, reach)
    x, y = field.x + 0.5 * cols * side, field.y + 0.5 * rows * side
    window = SearchWindow(reach, 0.25 * math.pi, angle_step(points, side))
    for heading in (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi):
        start = Pose2D(x, y, heading)
        if pose := search(pyramid, points, start, window, ACCEPTED.min_score, MAX_EVALUATIONS).pose:
            yield pose
