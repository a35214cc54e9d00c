"""Search for alternative poses that explain recent scans as well as the estimated pose."""

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D

from .likelihood_field import MAX_ENTRY, LikelihoodField, sum_fields

TOLERANCE = 0.03
"""Alternative poses that score lower than the estimated pose by more than this are discarded; scores are at most 1."""
MIN_LEAD = 0.35
"""A tracked pose is given up only for a pose that scores higher by more than this."""
MIN_SEPARATION, MIN_SEPARATION_ANGLE = 0.5, math.radians(20.0)
"""Poses within this distance [m] and heading difference [rad] count as one pose."""
MAX_RIVALS = 20
"""Maximum number of alternative poses that explain recent scans."""
MAX_HITS = 1000
"""Maximum number of beam end points used to score poses."""
MAX_PENETRATION = 0.2
"""Beams that end farther behind a mapped obstacle count as passing through the obstacle [m]."""
DENSITY, MAX_DRAWN = 4000.0, 1_000_000
"""Number of random poses that start a search for alternative poses: per free area of the map [1/m2], and maximum."""
NUM_SEARCHES = 3
"""The estimated pose is confirmed after this number of consecutive searches without alternative pose."""
MAX_PER_BIN = 4
"""Maximum number of poses that a search keeps per cell of 0.5 m and 20 degrees, for diversity."""
SEARCH = ((64, 10_000, (0.2, 0.2, 0.1)), (200, 2000, (0.1, 0.1, 0.05, 0.05)), (1000, 500, (0.05, 0.03, 0.02, 0.01)))
"""Stages of a coarse-to-fine random search for alternative poses. Each stage has the number of beam end points that
score a pose, the number of poses kept, and standard deviations of the random steps that improve poses [m]."""
NUM_COPIES, TRACKING_STEPS = 16, (0.03, 0.02, 0.01)
"""Random search that improves the known poses: number of copies per pose, standard deviations of the successive random
steps of copies [m]."""
STEP_SHAPE = np.array([[1.0], [1.0], [0.3]])

NO_RIVALS = np.empty((0, 4))
"""Empty table of alternative poses: x, y, heading [m, m, rad] and weight."""


@njit(cache=True, error_model="numpy")
def count_crossed(field, hits, lidars, margin, pose):
    """Count beams that pass through mapped obstacles more than `margin` cells before their end points.

    Grazing beams do not count. `hits`, `lidars`: end and start points of beams, shape (2, n), float32, base frame
    [cells]. `field`: likelihood field.
    """
    height, width = field.data.shape
    x, y = (pose[0] - field.origin[0]) / field.resolution, (pose[1] - field.origin[1]) / field.resolution
    c, s = math.cos(pose[2]), math.sin(pose[2])
    count = 0
    for k in range(hits.shape[1]):
        x0, y0 = x + c * lidars[0, k] - s * lidars[1, k], y + s * lidars[0, k] + c * lidars[1, k]
        dx, dy = x + c * hits[0, k] - s * hits[1, k] - x0, y + s * hits[0, k] + c * hits[1, k] - y0
        length = math.sqrt(dx * dx + dy * dy)
        dx, dy = dx / length, dy / length
        num_blocked = 0
        for side in (0.0, 1.0, -1.0):
            for j in range(1, int(length - margin)):
                row, col = math.floor(y0 + side * dx + j * dy), math.floor(x0 - side * dy + j * dx)
                if row >= 0 and col >= 0 and row < height and col < width and field.data[row, col] == MAX_ENTRY:
                    num_blocked += 1
                    break
        count += num_blocked == 3
    return count


def share_crossed(field: LikelihoodField, ranges: np.ndarray, pose: Pose2D) -> float:
    """Return the share of a scan's beams with a return that pass through mapped obstacles, for a pose."""
    geometry, (points, count) = field.beams.geometry, field.beams.hits(ranges)
    mount = np.array([[geometry.mount_x], [geometry.mount_y]], dtype=np.float32) / np.float32(geometry.resolution)
    margin, lidars = MAX_PENETRATION / geometry.resolution, np.repeat(mount, count, axis=1)
    crossed = count_crossed(field.table, points[:, :count].copy(), lidars, margin, np.array(pose, dtype=np.float32))
    return crossed / max(count, 1)


def are_apart(poses: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return a mask of `poses`, shape (3, n), that differ from `pose` by more than 0.5 m or 20 degrees."""
    x, y, turn = poses - pose
    return (np.hypot(x, y) > MIN_SEPARATION) | (np.cos(turn) < math.cos(MIN_SEPARATION_ANGLE))


def _thinned(poses: np.ndarray) -> np.ndarray:
    bins = np.floor(poses / np.array([[MIN_SEPARATION], [MIN_SEPARATION], [MIN_SEPARATION_ANGLE]])).astype(np.int64)
    bins -= bins.min(axis=1, keepdims=True)
    flat = np.ravel_multi_index(tuple(bins), tuple(bins.max(axis=1) + 1))
    order = np.argsort(flat, kind="stable")
    _, starts, counts = np.unique(flat[order], return_index=True, return_counts=True)
    ranks = np.arange(len(order)) - np.repeat(starts, counts)
    return poses[:, np.sort(order[ranks < MAX_PER_BIN])]


def _move(poses: np.ndarray, motion: Pose2D) -> np.ndarray:
    return np.reshape([Pose2D(*pose).compose(motion) for pose in poses.tolist()], (-1, 3))


class Rivals:
    """Search and tracking of alternative poses, which explain recent scans as well as the estimate.

    Score of a pose: mean likelihood field value at beam end points of recent scans, at most 1, minus the share of beams
    through obstacles.
    """

    def __init__(self, field: LikelihoodField, num_scans: int, least_lead: float = -TOLERANCE) -> None:
        self.least_lead = least_lead
        """Poses whose score minus the estimated pose's is lower than this are discarded."""
        self._beams, self._table = field.beams, field.table
        self._scans: deque[np.ndarray] = deque(maxlen=num_scans)
        self._num_scans, self._num_updates = num_scans, 0
        self.poses = np.empty((0, 3))
        """Estimated pose, then alternatives by descending score: x, y, heading, shape (k, 3), relative to the map's
        corner [m, m, rad]."""
        self.num_empty = 0
        self.leads = np.empty(0)
        """Score of each pose in `poses` minus the estimated pose's; positive if recent scans fit better."""

    def add(self, ranges: np.ndarray, motion: Pose2D) -> None:
        back, geometry = motion.inverse(), self._beams.geometry
        self._scans.extend([back.transform(scan) for scan in self._scans])
        points, count = self._beams.hits(ranges)
        lidar = geometry.mount_x, geometry.mount_y
        self._scans.append(np.vstack([points[:, :count].T * geometry.resolution, lidar]))
        self.poses = _move(self.poses, motion)

    def table(self, origin: np.ndarray, motion: Pose2D) -> np.ndarray:
        """Return alternative poses after odometry `motion`: x, y, heading, map frame [m, m, rad], relative weight."""
        if len(self.poses) <= 1:
            return NO_RIVALS
        return np.column_stack([_move(self.poses + origin, motion), np.exp(self.leads / TOLERANCE)])[1:]

    def update(self, pose: Pose2D, rng: np.random.Generator, area: float, draw: Callable[[int], np.ndarray]) -> None:
        """Refine alternative poses; search the map for new ones if none is known, and every `num_scans` calls.

        `area`: free space of the map [m2]. `draw(n)` returns n random poses in free space, shape (3, n), float32.
        """
        if not self._scans:
            return
        hits = np.vstack([scan[:-1] for scan in self._scans]) / self._table.resolution
        lidars = np.vstack([np.tile(scan[-1], (len(scan) - 1, 1)) for scan in self._scans]) / self._table.resolution
        # Kernels do not check bounds: drop hits beyond the table.
        used = np.flatnonzero(np.hypot(*hits.T) < self._table.border - 2)
        used = used[:: math.ceil(len(used) / MAX_HITS) or 1]
        self._hits, self._lidars = (rows[used].T.astype(np.float32, order="C") for rows in (hits, lidars))
        copies = np.repeat(np.vstack([pose, self.poses]).astype(np.float32).T, NUM_COPIES, axis=1)
        poses, scores = self._climb(copies, self._hits, TRACKING_STEPS, rng)
        own, poses = poses[:, [scores[:NUM_COPIES].argmax()]], poses[:, NUM_COPIES:]
        self._choose(own, poses)
        if len(self.poses) == 1 or self._num_updates % self._num_scans == 0:
            found = draw(math.ceil(min(DENSITY * area, MAX_DRAWN)))
            for num_hits, num_kept, steps in SEARCH:
                found = found[:, are_apart(found, own)]
                some = self._hits[:, :: max(1, self._hits.shape[1] // num_hits)].copy()
                best = np.argsort(-self._score(found, some), kind="stable")[: 20 * num_kept]
                found, _ = self._climb(_thinned(found[:, best])[:, :num_kept], some, steps, rng)
            self._choose(own, np.hstack([poses, found]))
            self.num_empty = self.num_empty + 1 if len(self.poses) == 1 else 0
        self._num_updates += 1

    def _score(self, poses: np.ndarray, hits: np.ndarray) -> np.ndarray:
        sums = np.empty(poses.shape[1], dtype=np.int32)
        sum_fields(self._table, hits, hits.shape[1], np.ascontiguousarray(poses), sums)
        return sums / (MAX_ENTRY * max(hits.shape[1], 1))

    def _climb(
        self, poses: np.ndarray, hits: np.ndarray, steps: Sequence[float], rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        scores = self._score(poses, hits)
        for step in steps:
            tried = poses + (step * STEP_SHAPE).astype(np.float32) * rng.standard_normal(poses.shape, dtype=np.float32)
            tried[2] = (tried[2] + math.pi) % (2.0 * math.pi) - math.pi
            tried_scores = self._score(tried, hits)
            is_better = tried_scores > scores
            poses, scores = np.where(is_better, tried, poses), np.where(is_better, tried_scores, scores)
        return poses, scores

    def _choose(self, own: np.ndarray, poses: np.ndarray) -> None:
        poses = np.hstack([own, poses])
        scores = self._score(poses, self._hits)
        poses = poses[:, scores >= scores[0] + 2.0 * min(self.least_lead, 0.0)]
        scored = self._table, self._hits, self._lidars, MAX_PENETRATION / self._table.resolution
        crossed = np.array([count_crossed(*scored, pose) for pose in poses.T.copy()])
        leads = self._score(poses, self._hits) - crossed / max(self._hits.shape[1], 1)
        leads -= leads[0]
        chosen = [0]
        for k in np.argsort(-leads, kind="stable").tolist():
            if leads[k] < self.least_lead or len(chosen) > MAX_RIVALS:
                break
            if are_apart(poses[:, chosen], poses[:, [k]]).all():
                chosen.append(k)
        self.poses, self.leads = poses[:, chosen].T.astype(np.float64), leads[chosen]
