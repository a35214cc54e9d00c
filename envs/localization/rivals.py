"""Rivals of an estimated pose: other poses on the map that explain recent scans as well."""

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import Pose2D

from .likelihood_field import ONE, LikelihoodField, sum_fields

TOLERANCE = 0.03
"""A rival explains recent scans at most by this share of their hits worse than the estimate; systematic errors of the
map, such as a wall that is half a cell off, account for as much."""
LEAST_WEIGHT = 1e-3
"""Weight of a rival that is worse by the tolerance, over that of the estimate."""
APART, APART_ANGLE = 0.5, math.radians(20.0)
"""Poses nearer than this to each other are one [m, rad]."""
MAX_RIVALS = 20
"""Rivals that are followed."""
DENSITY, MAX_DRAWN = 4000.0, 400_000
"""Random poses per area of free space that a search begins with [1/m2], and their greatest number."""
MAX_HITS = 1000
"""Hits of recent scans that are used."""
SEARCH = ((64, 10_000, (0.2, 0.2, 0.1)), (200, 2000, (0.1, 0.1, 0.05, 0.05)), (1000, 500, (0.05, 0.03, 0.02, 0.01)))
"""Stages of a search: number of hits that are scored, poses that are kept, and standard deviations of the random steps
by which each of them climbs [m]."""
STEP_SHAPE = np.array([[1.0], [1.0], [0.3]])
"""Standard deviations of a step's x, y and turn over its own [1, 1, rad/m]."""
MARGIN = 0.2
"""Beams may end this far behind an obstacle [m]."""
COPIES, FOLLOW = 16, (0.03, 0.02, 0.01)
"""Copies of a pose that climb from one scan to the next, and their steps [m]."""


@njit(cache=True, error_model="numpy")
def is_blocked(table, x, y, step_x, step_y, num_steps):
    """Tell whether one of so many steps from a point leads into an obstacle; all numbers in cells, steps of length 1."""
    height, width = table.shape
    for j in range(1, num_steps + 1):
        row, col = math.floor(y + j * step_y), math.floor(x + j * step_x)
        if row >= 0 and col >= 0 and row < height and col < width and table[row, col] == ONE:
            return True
    return False


@njit(cache=True, error_model="numpy")
def count_crossed(field, hits, lidars, poses, margin, counts):
    """Count the beams that pass through an obstacle of the map more than `margin` cells before they end.

    Parallels a cell to either side have to cross one as well, so that beams may graze obstacles. `field`: a `Field` of
    likelihoods; `hits`, `lidars`: shape (2, n), float32, ends and starts of the beams, base frame [cells]; `poses`:
    shape (3, k), float32 [m, m, rad]; `counts`: shape (k,), int64, written.
    """
    for i in range(poses.shape[1]):
        c, s = math.cos(poses[2, i]), math.sin(poses[2, i])
        x, y = (poses[0, i] - field.origin[0]) / field.resolution, (poses[1, i] - field.origin[1]) / field.resolution
        counts[i] = 0
        for k in range(hits.shape[1]):
            x0, y0 = x + c * lidars[0, k] - s * lidars[1, k], y + s * lidars[0, k] + c * lidars[1, k]
            dx, dy = hits[0, k] - lidars[0, k], hits[1, k] - lidars[1, k]
            length = math.sqrt(dx * dx + dy * dy)
            dx, dy = (c * dx - s * dy) / length, (s * dx + c * dy) / length
            is_crossed = True
            for side in (0.0, 1.0, -1.0):
                is_crossed = is_crossed and is_blocked(
                    field.data, x0 - side * dy, y0 + side * dx, dx, dy, int(length - margin)
                )
            counts[i] += is_crossed


def are_apart(poses: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Tell which poses, shape (3, n), are another one than a pose, shape (3, 1): shape (n,), bool."""
    x, y, turn = poses - pose
    return (np.hypot(x, y) > APART) | (np.cos(turn) < math.cos(APART_ANGLE))


class Rivals:
    """Finds the rivals of an estimate, and follows them from scan to scan.

    A pose is scored by the mean entry of the likelihood field at the hits of recent scans, of 1 at most, less the share
    of beams that pass through obstacles, which the field does not see.
    """

    def __init__(self, field: LikelihoodField, num_scans: int) -> None:
        """Score poses by the field of a map, and by the last `num_scans` scans."""
        self._beams, self._table = field.beams, field.table
        self._scans: deque[np.ndarray] = deque(maxlen=num_scans)
        self._num_scans, self._num_updates = num_scans, 0
        self.poses = np.empty((0, 3))
        """Shape (k, 3), float64: x, y, heading of the estimate, once there was one, and of its rivals, the best one
        first, in the frame of the field [m, m, rad]."""
        self.leads = np.empty(0)
        """Shape (k,), float64: scores of these poses less that of the estimate, at least -`TOLERANCE`."""

    def add(self, ranges: np.ndarray, motion: Pose2D) -> None:
        """Add a scan, shape (num_beams,), float32 [m], and the motion of the base since the one before."""
        back, geometry = motion.inverse(), self._beams.geometry
        self._scans.extend([back.transform(scan) for scan in self._scans])
        points, count = self._beams.hits(ranges)
        lidar = geometry.mount_x, geometry.mount_y
        self._scans.append(np.vstack([points[:, :count].T * geometry.resolution, lidar]))
        self.poses = self.poses_after(motion)

    def poses_after(self, motion: Pose2D) -> np.ndarray:
        """Return `poses` after a motion of the base."""
        return np.reshape([Pose2D(*pose).compose(motion) for pose in self.poses.tolist()], (-1, 3))

    def update(self, pose: Pose2D, rng: np.random.Generator, area: float, draw: Callable[[int], np.ndarray]) -> None:
        """Follow the rivals of an estimate; where there are none, and now and then, search the map for others.

        `draw` returns so many poses in the free space, which covers `area` [m2]: shape (3, n), float32.
        """
        if not self._scans:
            return
        hits = np.vstack([scan[:-1] for scan in self._scans]) / self._table.resolution
        lidars = np.vstack([np.tile(scan[-1], (len(scan) - 1, 1)) for scan in self._scans]) / self._table.resolution
        # Kernels check no index: seen from a pose on the map, no hit may lie beyond the border of the table.
        used = np.flatnonzero(np.hypot(*hits.T) < self._table.border - 2)
        used = used[:: math.ceil(len(used) / MAX_HITS) or 1]
        self._hits, self._lidars = (np.float32(rows[used].T.copy()) for rows in (hits, lidars))
        own, scores = self._climb(_copies([pose]), self._hits, FOLLOW, rng)
        own = own[:, [scores.argmax()]]
        followed, _ = self._climb(_copies(self.poses), self._hits, FOLLOW, rng)
        self._choose(own, followed)
        self._num_updates += 1
        if len(self.poses) == 1 or self._num_updates % self._num_scans == 0:
            poses = draw(math.ceil(min(DENSITY * area, MAX_DRAWN)))
            for num_hits, num_kept, steps in SEARCH:
                poses = poses[:, are_apart(poses, own)]
                hits = self._hits[:, :: max(1, self._hits.shape[1] // num_hits)].copy()
                best = np.argsort(-self._score(poses, hits), kind="stable")[:num_kept]
                poses, _ = self._climb(poses[:, best], hits, steps, rng)
            self._choose(own, np.hstack([poses, followed]))

    def _score(self, poses: np.ndarray, hits: np.ndarray) -> np.ndarray:
        sums = np.empty(poses.shape[1], dtype=np.int32)
        sum_fields(self._table, hits, hits.shape[1], poses, sums)
        return sums / (ONE * max(hits.shape[1], 1))

    def _climb(
        self, poses: np.ndarray, hits: np.ndarray, steps: Sequence[float], rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Improve poses, shape (3, n), by random steps; return them and their scores."""
        scores = self._score(poses, hits)
        for step in steps:
            tried = poses + np.float32(step * STEP_SHAPE) * rng.standard_normal(poses.shape, dtype=np.float32)
            tried[2] = (tried[2] + math.pi) % (2.0 * math.pi) - math.pi
            tried_scores = self._score(tried, hits)
            is_better = tried_scores > scores
            poses, scores = np.where(is_better, tried, poses), np.where(is_better, tried_scores, scores)
        return poses, scores

    def _choose(self, own: np.ndarray, poses: np.ndarray) -> None:
        """Take as rivals of `own`, shape (3, 1), those of `poses`, shape (3, n), that are as good, and apart."""
        poses = np.hstack([own, poses])
        scores = self._score(poses, self._hits)
        poses, scores = (rows[..., scores >= scores[0] - 2.0 * TOLERANCE] for rows in (poses, scores))
        counts = np.empty(len(scores), dtype=np.int64)
        count_crossed(self._table, self._hits, self._lidars, poses, MARGIN / self._table.resolution, counts)
        leads = scores - counts / max(self._hits.shape[1], 1)
        leads -= leads[0]
        chosen = [0]
        for k in np.argsort(-leads, kind="stable").tolist():
            if leads[k] < -TOLERANCE or len(chosen) > MAX_RIVALS:
                break
            if are_apart(poses[:, chosen], poses[:, [k]]).all():
                chosen.append(k)
        self.poses, self.leads = poses[:, chosen].T.astype(np.float64), leads[chosen]


def _copies(poses: np.ndarray | Sequence[Pose2D]) -> np.ndarray:
    """Return `COPIES` copies of each of `poses`, shape (k, 3): shape (3, k * COPIES), float32."""
    return np.repeat(np.array(poses, dtype=np.float32).T, COPIES, axis=1)
