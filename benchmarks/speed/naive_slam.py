"""Reference implementation of TinySLAM in idiomatic NumPy, without relocalization."""

import math

import numpy as np

from lidarnaut.envs.estimation import ORIGIN
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.slam import TinySlamParams
from lidarnaut.envs.slam.matching.covariance import NoiseRecord, motion_stds


def score(values: np.ndarray, points: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return the scan matching score of each pose: sum of occupancy `values` at scan points, shape (k,), float32.

    Scan points are in the robot frame, shape (2, n) [cells]; poses have shape (k, 3) [cells, cells, rad].
    """
    height, width = values.shape
    x, y, c, s = (
        part.astype(np.float32)[:, None] for part in (*poses[:, :2].T, np.cos(poses[:, 2]), np.sin(poses[:, 2]))
    )
    cols = (c * points[0] - s * points[1] + x).astype(np.int32)
    rows = (s * points[0] + c * points[1] + y).astype(np.int32)
    np.clip(cols, 0, width - 1, out=cols)
    np.clip(rows, 0, height - 1, out=rows)
    rows *= width
    rows += cols
    return values.take(rows).sum(axis=1)


def match(
    values: np.ndarray, points: np.ndarray, pose: Pose2D, sigma: tuple[float, float], weights: tuple[float, float],
    noise: np.ndarray, max_failed: int,
) -> Pose2D:  # fmt: skip
    """Return the pose that best matches scan points to a map, by random search around `pose` [cells, cells, rad].

    `sigma` is the standard deviation of the search in position [cells] and heading [rad]. `weights` penalize squared
    deviations from `pose`. `noise` is standard normal, shape (tries, 3).
    """
    spread, costs = np.array([sigma[0], *sigma]), np.array([weights[0], *weights])
    best_pose, failed = np.array(pose), 0
    best = score(values, points, best_pose[None])[0]
    while True:
        candidates = best_pose + spread * noise[: max_failed - failed]
        scores = score(values, points, candidates) - (candidates - np.array(pose)) ** 2 @ costs
        better = np.flatnonzero(scores > best)
        if len(better) == 0:
            return Pose2D(*best_pose.tolist())
        first = better[0]
        best, best_pose, noise = scores[first], candidates[first], noise[first + 1 :]
        failed += int(first)
        if failed > max_failed // 3:
            spread, failed = 0.5 * spread, 0


class NaiveSlam:
    """TinySLAM in NumPy; map cells average all observations.

    Map `values` (occupancy, 0 to 1, float32) and `counts` (number of observations) have shape (height, width).
    """

    def __init__(self, lidar: LidarParams, params: TinySlamParams, match_scans: bool = True) -> None:
        self._lidar, self._params, self._match_scans = lidar, params, match_scans
        angles = lidar.angles + lidar.mount.yaw
        self._directions = np.vstack([np.cos(angles), np.sin(angles)])
        self.shape = (round(params.map_height / params.resolution), round(params.map_width / params.resolution))
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        self._rng, self.pose, self.num_integrated = rng, ORIGIN, 0
        self._last_integrated: Pose2D | None = None
        self.values = np.full(self.shape, self._params.unvisited, dtype=np.float32)
        self.counts, self._sums = np.zeros(self.shape, dtype=np.int64), np.zeros(self.shape)

    def update(self, ranges: np.ndarray, motion: Pose2D) -> np.ndarray:
        """Update the pose estimate, and insert the scan into the map if the robot moved far enough.

        Returns newly known cells (row, column), shape (k, 2).
        """
        params, last = self._params, self._last_integrated
        predicted = self.pose = self.pose.compose(motion)
        moved = last.between(predicted) if last else ORIGIN
        travelled = math.hypot(moved.x, moved.y)
        if last and travelled < params.min_travel_distance and abs(moved.theta) < params.min_travel_angle:
            return np.empty((0, 2), dtype=np.int64)
        if self._match_scans and last:
            std, heading_std = motion_stds(NoiseRecord.of(params.odometry_noise), travelled, moved.theta)
            weights = params.prior_weight * (params.resolution / std) ** 2, params.prior_weight / heading_std**2
            self.pose = self._match(ranges, predicted, weights)
        self._last_integrated = self.pose
        self.num_integrated += 1
        raw = self._match_scans and self.pose == predicted
        return self.integrate(ranges, params.raw_quality if raw else params.quality)

    def to_cells(self, x: float, y: float) -> tuple[float, float]:
        return x / self._params.resolution + self.shape[1] // 2, y / self._params.resolution + self.shape[0] // 2

    def _match(self, ranges: np.ndarray, predicted: Pose2D, weights: tuple[float, float]) -> Pose2D:
        params, mount = self._params, self._lidar.mount
        hit = ranges < self._lidar.range_max
        points = ranges[hit] * self._directions[:, hit] + np.array([[mount.x], [mount.y]])
        points = (points / params.resolution).astype(np.float32)
        noise = self._rng.standard_normal((params.max_tries, 3))
        start = Pose2D(*self.to_cells(predicted.x, predicted.y), predicted.theta)
        sigma = (params.sigma_xy / params.resolution, params.sigma_theta)
        found = match(self.values, points, start, sigma, weights, noise, params.max_failed)
        if found == start:
            return predicted
        x, y = found.x - self.shape[1] // 2, found.y - self.shape[0] // 2
        return Pose2D(x * params.resolution, y * params.resolution, float(wrap_angle(found.theta)))

    def integrate(self, ranges: np.ndarray, quality: float) -> np.ndarray:
        """Insert a scan into the map at the current pose; return newly known cells (row, column), shape (k, 2)."""
        params, lidar = self._params, self._lidar
        sensor = self.pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, 0.0))
        x, y = self.to_cells(sensor.x, sensor.y)
        used = ~np.isnan(ranges) & ~(np.isinf(ranges) & params.skip_exceeding)
        reach = np.minimum(ranges[used].astype(np.float64), lidar.range_max) / params.resolution
        hits = ranges[used] < lidar.range_max
        c, s = math.cos(self.pose.theta), math.sin(self.pose.theta)
        cosines, sines = self._directions[:, used]
        end_x, end_y = x + reach * (c * cosines - s * sines), y + reach * (s * cosines + c * sines)
        start, ends = np.array([math.floor(y), math.floor(x)]), np.floor(np.column_stack([end_y, end_x])).astype(int)
        # Rasterize all beams at once.
        travel = ends - start
        lengths = np.abs(travel).max(axis=1)
        sizes = lengths + 1
        beams = np.repeat(np.arange(len(ends), dtype=np.int32), sizes)
        along = np.arange(len(beams)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        slopes, halves = travel / np.maximum(lengths, 1)[:, None], np.sign(travel) * (0.5 - 1e-9)
        rows, cols = (
            start[k] + (np.repeat(slopes[:, k], sizes) * along + np.repeat(halves[:, k], sizes)).astype(np.int32)
            for k in (0, 1)
        )
        left = np.repeat(lengths, sizes) - along

        probs, hole = np.full(len(rows), params.empty_prob), params.hole_width / params.resolution
        last = np.flatnonzero((left <= hole) & (hits & ((travel**2).sum(axis=1) > hole**2))[beams])
        square = (rows[last] - ends[beams[last], 0]) ** 2 + (cols[last] - ends[beams[last], 1]) ** 2
        last, square = last[square < hole**2], square[square < hole**2]
        probs[last] = params.occupied_prob * (1.0 - square / hole**2)
        probs[(left == 0) & hits[beams]] = params.occupied_prob

        inside = (rows > 0) & (rows < self.shape[0] - 1) & (cols > 0) & (cols < self.shape[1] - 1)
        cells = rows[inside] * self.shape[1] + cols[inside]
        sums, counts = self._sums.ravel(), self.counts.ravel()
        new = np.unique(cells[counts[cells] == 0])
        np.add.at(sums, cells, (0.5 + (probs - 0.5) * quality)[inside])
        np.add.at(counts, cells, 1)
        self.values.ravel()[cells] = sums[cells] / counts[cells]
        return np.column_stack(np.divmod(new, self.shape[1]))
