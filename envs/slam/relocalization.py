"""Relocalization: finding the pose of a robot on its own map again, as after it was kidnapped.

Scans since the loss are joined by odometry, and searched at all poses of the map by branch and bound (Hess et al.,
Real-time loop closure in 2D lidar SLAM, 2016): one scan of a short-range lidar fits in many places, twenty seldom do.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.estimation import ORIGIN
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.pose import distance
from lidarnaut.envs.robots import LidarParams

from .key_scans import KeyScans, has_moved
from .matching.branch_and_bound import NO_EXCLUSION, SearchResult, SearchWindow, angle_step, search
from .matching.fields import Field, HitShares, Pyramid, build_pyramid, count_crossings, hit_shares, is_accepted
from .params import LoopClosureParams
from .scans import ScanGeometry

NUM_SCANS = 20
"""Key scans that are searched together."""
LEAST_SCANS, SEARCH_EVERY, MAX_INTERVAL = 4, 2, 8
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
NEAR_DISTANCE = 2.0
"""Distance from the pose by odometry up to which a pose is near [m]: a robot is lost more often because its map bends
than because it was kidnapped."""
NEAR_EVIDENCE, DISTANT_EVIDENCE, MAX_LEAD = 0.5, 1.0, 0.25
"""Sum of leads, in searches in succession that agree on a pose, which makes a near one certain, and another one; and
what counts at most of the lead of one search."""
AGREEMENT_DISTANCE, AGREEMENT_ANGLE = 0.3, 0.1
"""By how much poses that agree differ at most [m], [rad]."""
RIVAL_DISTANCE, RIVAL_ANGLE, RIVAL_SCORE_MARGIN = 0.5, 0.2, 0.15
"""How far rivals of a pose are from it at least in coarse cells [m], [rad], and by how much their score may be less."""
LEAST_LEAD = 0.05
"""By how much the merit of a pose must exceed that of its rivals: its lead."""
MAX_CROSSING, LEAST_JUDGED, CROSSING_SCANS = 0.52, 40, 3
"""Share of the beams of a key scan that may pass through occupied cells, beams from which on it is asked for, and key
scans in succession above it after which the robot is lost, however well their hits fit. On the log of a real robot it
is up to 0.5 before a loop is closed."""
RECOVERY_SCANS = 4
"""Key scans in succession that fit where odometry leads, without beams through walls, after which a robot is no longer
lost: people who stood around it have left."""
SEARCH_HEADINGS = (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi)
"""Headings around which the map is searched [rad]."""
FOUND_STD = (0.1, 0.1, 0.03)
"""Standard deviation of a pose that was found [m, m, rad]."""
ACCEPTANCE = LoopClosureParams(min_score=0.45, min_occupied=0.8, max_free=0.05, min_agreement=0.95)
"""What a pose must reach; see `is_accepted`."""
MAX_ACCEPTED_CROSSING = 0.08
"""Share of the beams of the joined scans that may pass through occupied cells at a pose that is taken."""


class LocalizationMonitor:
    """Tells when scans in succession do not fit the map, and relocalizes the robot."""

    def __init__(self, lidar: LidarParams, lost_scans: int, has_odometry: bool = True) -> None:
        """Track a SLAM for one lidar; the robot is lost after `lost_scans` key scans in succession that do not fit.

        Relocalization ends a loss, or scans in succession that fit: sooner or later a single one fits where a kidnapped
        robot is not. Without odometry, which joins scans, one that fits has to do.
        """
        self._lost_scans, self._has_odometry = lost_scans, has_odometry
        self._geometry = ScanGeometry.of(lidar, 1.0)
        self._relocalizer = Relocalizer(lidar)
        self.meets_people = False
        """Whether people may have left what beams pass through, so that this does not count."""
        self.reset()

    def reset(self) -> None:
        """Start with a robot that is not lost."""
        self._mismatches = self._num_crossing = self._num_consistent = 0
        self.is_found = False
        """Whether the last key scan has relocalized the robot."""
        self._relocalizer.reset()

    @property
    def has_mismatch(self) -> bool:
        """Whether a scan has not fitted, and none has since; the robot need not be lost yet."""
        return self._mismatches > 0

    @property
    def is_lost(self) -> bool:
        """Whether scans in succession have not fitted."""
        return self._mismatches >= self._lost_scans

    def update(
        self,
        ranges: np.ndarray,
        predicted: Pose2D,
        pose: tuple[float, float, float],
        fits: bool | None,
        grid: OccupancyGrid,
    ) -> Pose2D | None:
        """Process a key scan, shape (num_beams,), float32 [m], at a pose predicted by odometry and that of its match.

        A scan that does not fit is not integrated, and no scan of a lost robot is; its pose follows odometry. `fits` is
        None where too little of the map, `grid`, is known to tell. Returns the pose to go on with, map frame, if the
        scan must not be integrated; None if that of its match is taken.
        """
        self.is_found = False
        if self.meets_people:
            self._num_consistent = self._num_consistent + 1 if fits and self.is_lost else 0
        elif self._has_odometry:
            field = Field(grid.data, *grid.origin, grid.resolution)
            crossing, judged = count_crossings(field, ranges, self._geometry, pose)
            if self.is_lost:
                is_consistent = fits and judged >= LEAST_JUDGED and crossing <= MAX_ACCEPTED_CROSSING * judged
                self._num_consistent = self._num_consistent + 1 if is_consistent else 0
            else:
                is_crossing = judged >= LEAST_JUDGED and crossing > MAX_CROSSING * judged
                self._num_crossing = self._num_crossing + 1 if is_crossing else 0
                if self._num_crossing >= CROSSING_SCANS:
                    fits, self._mismatches = False, self._lost_scans
        if self.is_lost and self._num_consistent >= RECOVERY_SCANS:
            self.reset()
            self.is_found = True
            return None
        if fits and not (self.is_lost and self._has_odometry):
            if self.has_mismatch:
                self._mismatches = 0
                self._relocalizer.reset()
            return None
        if fits is None and not self.has_mismatch:
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
        self._lidar, self._geometry = lidar, ScanGeometry.of(lidar, 1.0)
        self.reset()

    def reset(self) -> None:
        """Forget all scans: the robot is not lost, or no longer."""
        self._scans = KeyScans(self._lidar)
        self._next, self._interval = LEAST_SCANS, SEARCH_EVERY
        self._evidence, self._found = 0.0, (ORIGIN, ORIGIN)

    def update(self, ranges: np.ndarray, pose: Pose2D, grid: OccupancyGrid | None) -> Pose2D | None:
        """Add a key scan, shape (num_beams,), float32 [m], and its pose by odometry; search the map when it is due.

        Without a map nothing is searched. Returns the pose of the scan, map frame, once searches in succession agree,
        and nothing else on the map is like it.
        """
        self._scans.add(ranges, pose)
        if grid is None or len(self._scans) < self._next:
            return None
        found, lead = self.search(grid)
        self._interval = SEARCH_EVERY if found is not None else min(2 * self._interval, MAX_INTERVAL)
        self._next = len(self._scans) + self._interval
        if found is None:
            self._evidence = 0.0
            return None
        before, there = self._found
        if has_moved(*before.compose(there.between(pose)), *found, AGREEMENT_DISTANCE, AGREEMENT_ANGLE):
            self._evidence = 0.0
        self._found, self._evidence = (found, pose), self._evidence + min(lead, MAX_LEAD)
        is_near = distance(found.x - pose.x, found.y - pose.y) <= NEAR_DISTANCE
        return found if self._evidence >= (NEAR_EVIDENCE if is_near else DISTANT_EVIDENCE) else None

    def search(self, grid: OccupancyGrid) -> tuple[Pose2D | None, float]:
        """Return the pose of the robot at the last key scan, map frame, and its lead.

        The pose is None where none or more than one will do.
        """
        last = len(self._scans) - 1
        points = self._scans.joined_points(max(last + 1 - NUM_SCANS, 0), last, math.inf, MAX_POINTS)
        if len(points) < LEAST_POINTS:
            return None, 0.0
        field = Field.of(grid)
        search_around = _coarse_search(field, points)
        fit = partial(self._fit, field, build_pyramid(field, 3, FINE_WIDTH), points)
        found = [search_around(heading) for heading in SEARCH_HEADINGS]
        fits = [fit(result.pose) for result in found if result.pose]
        best = max(fits, default=None)
        if best is None or best.crossing > MAX_ACCEPTED_CROSSING or not is_accepted(best.shares, ACCEPTANCE):
            return None, 0.0
        least = max(result.score for result in found) - RIVAL_SCORE_MARGIN
        for heading, result in zip(SEARCH_HEADINGS, found):
            if result.pose and result.score >= least:
                rival = search_around(heading, least, (*result.pose, RIVAL_DISTANCE, RIVAL_ANGLE)).pose
                fits += [fit(rival)] if rival else []
        rivals = (fit.merit for fit in fits if has_moved(*best.pose, *fit.pose, AGREEMENT_DISTANCE, AGREEMENT_ANGLE))
        lead = best.merit - max(rivals, default=-math.inf)
        return (best.pose if lead >= LEAST_LEAD else None), lead

    def _fit(self, field: Field, pyramid: Pyramid, points: np.ndarray, rough: Pose2D) -> "_Fit":
        """Return how the joined scans fit at the best pose near one that was found in coarse cells."""
        window = SearchWindow(FINE_WIDTH, FINE_ANGLE, 0.01)
        pose = search(pyramid, points, rough, window, 0.0, MAX_EVALUATIONS).pose or rough
        shares, crossing = hit_shares(field, points, pose), self._crossing(field, pose)
        known = max(shares.occupied + shares.free, 1e-9)
        return _Fit((shares.occupied - shares.free) / known - crossing, crossing, shares, pose)

    def _crossing(self, field: Field, pose: Pose2D) -> float:
        """Return the share of the joined scans' beams that pass through occupied cells, at a pose of the last."""
        last = len(self._scans) - 1
        to_map = pose.compose(Pose2D(*self._scans.poses[last].tolist()).inverse())
        counts = np.zeros(2)
        for k in range(max(last + 1 - NUM_SCANS, 0), last + 1):
            there = to_map.compose(Pose2D(*self._scans.poses[k].tolist()))
            counts += count_crossings(field, self._scans.ranges[k], self._geometry, tuple(there))
        return float(counts[0] / max(counts[1], 1.0))


class _Fit(NamedTuple):
    """How scans fit at a pose."""

    merit: float
    """Share of points on known cells at walls, less that in free ones, less that of beams through walls.

    What is unknown does not tell a pose from its rivals: the robot may be where the map is not complete.
    """
    crossing: float
    """Share of beams that pass through occupied cells."""
    shares: HitShares
    pose: Pose2D


def _coarse_search(field: Field, points: np.ndarray) -> Callable[..., SearchResult]:
    """Return a search of a whole map in coarse cells, at the quarter of headings around one [rad].

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
    window = SearchWindow(reach, 0.25 * math.pi, angle_step(points, side))
    x, y = field.x + 0.5 * cols * side, field.y + 0.5 * rows * side

    def search_around(heading: float, min_score: float = ACCEPTANCE.min_score, excluded: Any = NO_EXCLUSION) -> Any:
        return search(pyramid, points, Pose2D(x, y, heading), window, min_score, MAX_EVALUATIONS, excluded)

    return search_around
