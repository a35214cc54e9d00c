"""Relocalization of a lost or kidnapped robot on its own map.

Scans since the loss are merged by odometry, because one scan is ambiguous, and matched to the whole map by branch and
bound (Hess et al., Real-time loop closure in 2D lidar SLAM, 2016).
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.estimation.scan_points import ScanGeometry
from lidarnaut.envs.geometry import ORIGIN, UNKNOWN, OccupancyGrid, Pose2D, distance
from lidarnaut.envs.geometry.occupancy_grid import blocks_of
from lidarnaut.envs.robots import LidarParams

from .key_scans import KeyScans, has_moved
from .matching.branch_and_bound import NO_EXCLUSION, SearchResult, SearchWindow, angle_step, search
from .matching.fields import Field, HitShares, Pyramid, build_pyramid, count_crossings, hit_shares, is_accepted
from .slam_params import LoopClosureParams

NUM_SCANS = 20
"""Maximum number of recent scans merged for a relocalization search."""
LEAST_SCANS, SEARCH_EVERY, MAX_INTERVAL = 4, 2, 8
"""Numbers of scans since the robot is lost: before the first search, between two searches (doubled after each failure),
and maximum between two searches."""
COARSE_CELL = 0.1
NUM_LEVELS = 6
MAX_POINTS, LEAST_POINTS = 300, 40
"""Maximum number of scan points in a relocalization search, and minimum number to run it."""
MAX_EVALUATIONS = 500_000
FINE_WIDTH, FINE_ANGLE = 0.2, 0.04
"""Half width [m] and half angle [rad] of the fine search around a coarse result."""
NEAR_DISTANCE = 2.0
"""Relocalized poses within this distance of the odometry pose are accepted on less evidence [m]."""
NEAR_EVIDENCE, DISTANT_EVIDENCE, MAX_LEAD = 0.5, 1.0, 0.25
"""Evidence to accept a relocalized pose: minimum near the odometry pose, minimum elsewhere, and maximum from one
search. Evidence is the fit to the map minus the fit of the best alternative, summed over searches that agree."""
GOOD_FIT = 0.9
"""The lead of a pose with a lower fit counts half: another part of the building may look similar."""
AGREEMENT_DISTANCE, AGREEMENT_ANGLE = 0.3, 0.1
"""Distance [m] and angle [rad] below which two candidate poses of relocalization count as equal."""
RIVAL_DISTANCE, RIVAL_ANGLE, RIVAL_SCORE_MARGIN = 0.5, 0.2, 0.15
"""Alternatives to a relocalized pose: minimum distance [m] or angle [rad] from it, and maximum difference in score."""
LEAST_LEAD = 0.05
"""Minimum difference in fit between a relocalized pose and the next-best one. Fit: fraction of scan points on walls,
minus points in free space and beams through walls."""
MAX_CROSSING, LEAST_JUDGED, CROSSING_SCANS = 0.52, 40, 3
"""Criterion for a lost robot: maximum fraction of beams through occupied cells, minimum number of tested beams, and
number of consecutive scans above the maximum."""
LOST_SCANS, RECOVERY_SCANS = 3, 4
"""Numbers of consecutive scans: those that do not fit the map make the robot lost; those that fit end the lost state
without relocalization."""
SEARCH_HEADINGS = (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi)
FOUND_STD = (0.1, 0.1, 0.03)
"""Standard deviations of a relocalized pose [m, m, rad]."""
ACCEPTANCE = LoopClosureParams(min_score=0.45, min_occupied=0.8, max_free=0.05, min_agreement=0.95)
ACCEPTANCE_PARTLY_KNOWN = LoopClosureParams(min_score=0.4, min_occupied=0.5, max_free=0.02, min_agreement=0.95)
LEAST_KNOWN_BEAMS = 0.65
"""Criterion for poses where part of the scan points lies in unknown cells, if at least this fraction of the beams runs
mostly through known cells. Poses outside of the mapped area also have few points in free cells."""
MAX_ACCEPTED_CROSSING = 0.08
"""Maximum fraction of beams through occupied cells at a relocalized pose, and at a matched pose after a jump."""
MAX_JUMP = 0.4
"""Distance of a matched pose from the odometry pose that is a jump, as after a kidnapping to a similar place [m].
After a drive of twice this distance without a scan, odometry may be as far off."""


class LocalizationMonitor:
    """Monitor that detects a lost robot by scans that do not fit the map, and relocalizes the robot."""

    def __init__(self, lidar: LidarParams, has_odometry: bool = True) -> None:
        """Create a monitor; the robot is lost after `LOST_SCANS` consecutive scans that do not fit the map.

        Without odometry, one fitting scan ends the lost state.
        """
        self._has_odometry = has_odometry
        self._geometry = ScanGeometry.of(lidar)
        self._relocalizer = Relocalizer(lidar)
        self.meets_people = False
        """Whether the robot tracks people; beams through occupied cells are then ignored."""
        self.reset()

    def reset(self) -> None:
        self._mismatches = self._num_crossing = self._num_consistent = 0
        self._last: tuple[float, float] | None = None
        self.is_found = False
        """Whether a lost robot was localized again at the last scan."""
        self._relocalizer.reset()

    @property
    def has_mismatch(self) -> bool:
        return self._mismatches > 0

    @property
    def is_lost(self) -> bool:
        """Whether too many consecutive scans did not fit the map."""
        return self._mismatches >= LOST_SCANS

    def update(
        self,
        ranges: np.ndarray,
        predicted: Pose2D,
        pose: tuple[float, float, float],
        fits: bool | None,
        grid: OccupancyGrid,
    ) -> Pose2D | None:
        """Judge whether the robot is lost, and relocalize it; return a pose that replaces the matched pose, or None.

        `ranges`: scan, shape (num_beams,), float32 [m]. `predicted`: odometry pose; `pose`: matched pose; map frame.
        `fits`: whether the scan fits the map, None if too few cells are known.
        """
        self.is_found = False
        (x, y), self._last = self._last or pose[:2], pose[:2]
        driven = distance(predicted.x - x, predicted.y - y)
        if self.meets_people:
            self._num_consistent = self._num_consistent + 1 if fits and self.is_lost else 0
        elif self._has_odometry:
            field = Field(grid.data, *grid.origin, grid.resolution)
            is_jump = distance(pose[0] - predicted.x, pose[1] - predicted.y) > MAX_JUMP and driven < 2.0 * MAX_JUMP
            least_share = 0.0 if self.is_lost or is_jump else MAX_CROSSING
            crossing, judged = count_crossings(field, ranges, self._geometry, pose, least_share)
            if self.is_lost:
                is_consistent = fits and judged >= LEAST_JUDGED and crossing <= MAX_ACCEPTED_CROSSING * judged
                self._num_consistent = self._num_consistent + 1 if is_consistent else 0
            else:
                if is_jump:
                    fits = fits and crossing <= MAX_ACCEPTED_CROSSING * judged
                is_crossing = judged >= LEAST_JUDGED and crossing > MAX_CROSSING * judged
                self._num_crossing = self._num_crossing + 1 if is_crossing else 0
                if self._num_crossing >= CROSSING_SCANS:
                    fits, self._mismatches = False, LOST_SCANS
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
    """Search for the pose of a lost robot on its map, with the scans since the loss."""

    def __init__(self, lidar: LidarParams) -> None:
        self._lidar, self._geometry = lidar, ScanGeometry.of(lidar)
        self.reset()

    def reset(self) -> None:
        self._scans = KeyScans(self._lidar)
        self._next, self._interval = LEAST_SCANS, SEARCH_EVERY
        self._evidence, self._found = 0.0, (ORIGIN, ORIGIN)

    def update(self, ranges: np.ndarray, pose: Pose2D, grid: OccupancyGrid | None) -> Pose2D | None:
        """Add a scan, shape (num_beams,), float32 [m], and its odometry pose; every few scans, search the map.

        Returns the robot pose, map frame, once consecutive searches agree; otherwise None. `grid`: None to only add the
        scan.
        """
        self._scans.add(ranges, pose)
        if grid is None or len(self._scans) < self._next:
            return None
        found, lead = self.search(grid)
        is_clear = found is not None and lead >= LEAST_LEAD
        self._interval = SEARCH_EVERY if is_clear else min(2 * self._interval, MAX_INTERVAL)
        self._next = len(self._scans) + self._interval
        if found is None:
            self._evidence = 0.0
        if found is None or not is_clear:  # an ambiguous place does not contradict an earlier result
            return None
        before, there = self._found
        if has_moved(*before.compose(there.between(pose)), *found, AGREEMENT_DISTANCE, AGREEMENT_ANGLE):
            self._evidence = 0.0
        self._found, self._evidence = (found, pose), self._evidence + lead
        is_near = distance(found.x - pose.x, found.y - pose.y) <= NEAR_DISTANCE
        return found if self._evidence >= (NEAR_EVIDENCE if is_near else DISTANT_EVIDENCE) else None

    def search(self, grid: OccupancyGrid) -> tuple[Pose2D | None, float]:
        """Search the whole map for the robot; return its pose, map frame, and lead in fit over the next-best pose.

        The pose belongs to the last scan; it is None if the fit is poor.
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
        if best is None or not best.is_accepted:
            return None, 0.0
        least = max(result.score for result in found) - RIVAL_SCORE_MARGIN
        for heading, result in zip(SEARCH_HEADINGS, found):
            if result.pose and result.score >= least:
                rival = search_around(heading, least, (*result.pose, RIVAL_DISTANCE, RIVAL_ANGLE)).pose
                fits += [fit(rival)] if rival else []
        rivals = (fit.merit for fit in fits if has_moved(*best.pose, *fit.pose, AGREEMENT_DISTANCE, AGREEMENT_ANGLE))
        lead = min(best.merit - max(rivals, default=-math.inf), MAX_LEAD)
        return best.pose, lead if best.merit >= GOOD_FIT else 0.5 * lead

    def _fit(self, field: Field, pyramid: Pyramid, points: np.ndarray, rough: Pose2D) -> "_Fit":
        window = SearchWindow(FINE_WIDTH, FINE_ANGLE, 0.01)
        pose = search(pyramid, points, rough, window, 0.0, MAX_EVALUATIONS).pose or rough
        shares, (crossing, known_beams) = hit_shares(field, points, pose), self._beam_shares(field, pose)
        known = max(shares.occupied + shares.free, 1e-9)
        return _Fit((shares.occupied - shares.free) / known - crossing, crossing, known_beams, shares, pose)

    def _beam_shares(self, field: Field, pose: Pose2D) -> tuple[float, float]:
        """Return the share of beams through occupied cells, and the share of beams that are tested for that."""
        last = len(self._scans) - 1
        to_map = pose.compose(Pose2D(*self._scans.poses[last].tolist()).inverse())
        counts, num_beams = np.zeros(2), 0
        for k in range(max(last + 1 - NUM_SCANS, 0), last + 1):
            there = to_map.compose(Pose2D(*self._scans.poses[k].tolist()))
            ranges = self._scans.ranges[k]
            counts += count_crossings(field, ranges, self._geometry, tuple(there), 0.0)
            num_beams += int(np.count_nonzero(ranges > 0.0))
        return float(counts[0] / max(counts[1], 1.0)), float(counts[1] / max(num_beams, 1))


class _Fit(NamedTuple):
    merit: float
    crossing: float
    known_beams: float
    shares: HitShares
    pose: Pose2D

    @property
    def is_accepted(self) -> bool:
        is_known = is_accepted(self.shares, ACCEPTANCE)
        is_partly = self.known_beams >= LEAST_KNOWN_BEAMS and is_accepted(self.shares, ACCEPTANCE_PARTLY_KNOWN)
        return self.crossing <= MAX_ACCEPTED_CROSSING and (is_known or is_partly)


def _coarse_search(field: Field, points: np.ndarray) -> Callable[..., SearchResult]:
    block = max(1, round(COARSE_CELL / field.resolution))
    coarse = blocks_of(field.occupancy, block, UNKNOWN).max(axis=2)
    rows, cols = coarse.shape
    side = block * field.resolution
    reach = 0.5 * max(rows, cols) * side
    pyramid = build_pyramid(Field(coarse, field.x, field.y, side), NUM_LEVELS, reach)
    window = SearchWindow(reach, 0.25 * math.pi, angle_step(points, side))
    x, y = field.x + 0.5 * cols * side, field.y + 0.5 * rows * side

    def search_around(heading: float, min_score: float = ACCEPTANCE.min_score, excluded: Any = NO_EXCLUSION) -> Any:
        return search(pyramid, points, Pose2D(x, y, heading), window, min_score, MAX_EVALUATIONS, excluded)

    return search_around
