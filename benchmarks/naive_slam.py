"""TinySLAM in idiomatic NumPy, for comparison: algorithm, parameters and work are those of `envs.slam`.

Key scans are matched, with odometry as a prior; others are passed over. A robot that is lost is not relocalized.
"""

import math

import numpy as np

from envs.geometry import Pose2D, wrap_angle
from envs.robots import LidarParams
from envs.slam import TinySlamParams


def score(values: np.ndarray, points: np.ndarray, x: np.ndarray, y: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Sum the occupancies under a scan's hits at k poses at once, in cells from the map's corner.

    `values` are occupancies, shape (height, width), float32, of which the outermost are never observed; `points` are
    hits in the base frame, shape (2, n), float32. Returns shape (k,), float32.
    """
    height, width = values.shape
    c, s = (part.astype(np.float32)[:, None] for part in (np.cos(theta), np.sin(theta)))
    cols = (c * points[0] - s * points[1] + x.astype(np.float32)[:, None]).astype(np.int32)
    rows = (s * points[0] + c * points[1] + y.astype(np.float32)[:, None]).astype(np.int32)
    np.clip(cols, 0, width - 1, out=cols)
    np.clip(rows, 0, height - 1, out=rows)
    rows *= width
    rows += cols
    return values.take(rows).sum(axis=1)


def match(
    values: np.ndarray,
    points: np.ndarray,
    pose: Pose2D,
    sigma: tuple[float, float],
    weights: tuple[float, float],
    noise: np.ndarray,
    max_failed: int,
) -> Pose2D:
    """Search the pose at which a scan fits the map best, as `envs.slam.matcher.match` does; see `score`.

    All candidates that are left are scored around the best pose so far. From the first that is better, the rest are
    scored anew around it: three to five rounds for a scan, faster than a hundred candidates one by one. `sigma` is the
    spread of positions [cells] and headings [rad], `weights` what a squared deviation of either from the predicted pose
    costs, `noise` standard normal, shape (tries, 3), float64.
    """
    spread = np.array([sigma[0], sigma[0], sigma[1]])
    pose_now = np.array(pose)
    squared_weights = np.array([weights[0], weights[0], weights[1]])
    best = score(values, points, *pose_now[:, None])[0]
    failed = 0
    while True:
        candidates = pose_now + spread * noise[: max_failed - failed]
        scores = score(values, points, *candidates.T) - (candidates - np.array(pose)) ** 2 @ squared_weights
        better = np.flatnonzero(scores > best)
        if len(better) == 0:
            return Pose2D(*pose_now.tolist())
        first = better[0]
        best, pose_now, noise = scores[first], candidates[first], noise[first + 1 :]
        failed += int(first)
        if failed > max_failed // 3:
            spread, failed = 0.5 * spread, 0


def trace_beams(start: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Walk straight lines of cells, (row, column), int64, all beams at once, from `start` to `ends`, shape (n, 2).

    Returns of every cell of every beam the row, the column, the index of the beam, and how many cells follow in it:
    shape (total,) each.
    """
    travel = ends - start
    lengths = np.abs(travel).max(axis=1)
    sizes = lengths + 1
    beams = np.repeat(np.arange(len(ends), dtype=np.int32), sizes)
    along = np.arange(len(beams)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    slopes = travel / np.maximum(lengths, 1)[:, None]
    # Half a cell, less a grain: a line right between two cells takes the one nearer to its start.
    halves = np.sign(travel) * (0.5 - 1e-9)
    rows, cols = (
        start[axis] + (np.repeat(slopes[:, axis], sizes) * along + np.repeat(halves[:, axis], sizes)).astype(np.int32)
        for axis in (0, 1)
    )
    return rows, cols, beams, np.repeat(lengths, sizes) - along


class NaiveSlam:
    """TinySLAM with the mean of all observations in its cells (`avg`), the `const` estimator, and the `assign` blur.

    The map has the size that the params give it; beams that leave it are cut off at its border.
    """

    def __init__(self, lidar: LidarParams, params: TinySlamParams, match_scans: bool = True) -> None:
        """Build a SLAM for one lidar; without matching it takes the pose that the motions lead to."""
        self._lidar, self._params, self._match_scans = lidar, params, match_scans
        angles = lidar.angles + lidar.mount.yaw
        self._directions = np.vstack([np.cos(angles), np.sin(angles)])
        self.resolution = params.resolution
        self.shape = (round(params.map_height / params.resolution), round(params.map_width / params.resolution))
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Forget everything: an unknown map with the robot in its middle. Candidates are sampled from `rng`."""
        self._rng = rng
        self.values = np.full(self.shape, self._params.unvisited, dtype=np.float32)
        """Shape (height, width), float32: occupancies, `unvisited` where nothing was observed."""
        self.counts = np.zeros(self.shape, dtype=np.int64)
        """Shape (height, width), int64: number of observations."""
        self._sums = np.zeros(self.shape)
        self.pose = Pose2D(0.0, 0.0, 0.0)
        """Estimated pose; the first is the origin."""
        self.num_integrated = 0
        self._last_integrated: Pose2D | None = None

    def update(self, ranges: np.ndarray, motion: Pose2D) -> np.ndarray:
        """Process a scan, see `Estimator.update`; return (row, column) of the cells that became known, shape (k, 2)."""
        predicted = self.pose = self.pose.compose(motion)
        if not self._has_moved():
            return np.empty((0, 2), dtype=np.int64)
        if self._match_scans and self.num_integrated > 0:
            self.pose = self._match(ranges, predicted)
        self._last_integrated = self.pose
        raw = self._match_scans and self.pose == predicted
        quality = self._params.raw_quality if raw else self._params.quality
        self.num_integrated += 1
        return self.integrate(ranges, quality)

    def to_cells(self, x: float, y: float) -> tuple[float, float]:
        """Return a position in the map frame [m] as distances from the map's corner [cells]."""
        return x / self.resolution + self.shape[1] // 2, y / self.resolution + self.shape[0] // 2

    def _has_moved(self) -> bool:
        if self._last_integrated is None:
            return True
        distance = math.hypot(self.pose.x - self._last_integrated.x, self.pose.y - self._last_integrated.y)
        turn = abs(wrap_angle(self.pose.theta - self._last_integrated.theta))
        return distance >= self._params.min_travel_distance or turn >= self._params.min_travel_angle

    def _match(self, ranges: np.ndarray, predicted: Pose2D) -> Pose2D:
        params, mount = self._params, self._lidar.mount
        hit = ranges < self._lidar.range_max
        points = ranges[hit] * self._directions[:, hit] + np.array([[mount.x], [mount.y]])
        points = (points / self.resolution).astype(np.float32)
        noise = self._rng.standard_normal((params.max_tries, 3))
        start = Pose2D(*self.to_cells(predicted.x, predicted.y), predicted.theta)
        sigma = (params.sigma_xy / self.resolution, params.sigma_theta)
        found = match(self.values, points, start, sigma, self._weights(predicted), noise, params.max_failed)
        if found == start:
            return predicted
        x, y = found.x - self.shape[1] // 2, found.y - self.shape[0] // 2
        return Pose2D(x * self.resolution, y * self.resolution, float(wrap_angle(found.theta)))

    def _weights(self, predicted: Pose2D) -> tuple[float, float]:
        """Return what a squared deviation from the predicted pose costs, by the noise of odometry; see `match`."""
        assert self._last_integrated is not None
        moved, noise = self._last_integrated.between(predicted), self._params.odometry_noise
        travelled, weight = math.hypot(moved.x, moved.y), self._params.prior_weight
        position_std = noise.position_std + noise.position_per_metre * travelled
        heading_std = (
            noise.heading_std + noise.heading_per_radian * abs(moved.theta) + noise.heading_per_metre * travelled
        )
        return weight * (self.resolution / position_std) ** 2, weight / heading_std**2

    def integrate(self, ranges: np.ndarray, quality: float) -> np.ndarray:
        """Average every cell of every beam of a scan at `pose` into the map; return the cells that became known."""
        params, lidar = self._params, self._lidar
        sensor = self.pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, 0.0))
        x, y = self.to_cells(sensor.x, sensor.y)
        used = ~np.isnan(ranges) & ~(np.isinf(ranges) & params.skip_exceeding)
        reach = np.minimum(ranges[used].astype(np.float64), lidar.range_max) / self.resolution
        hits = ranges[used] < lidar.range_max
        c, s = math.cos(self.pose.theta), math.sin(self.pose.theta)
        cosines, sines = self._directions[:, used]
        end_x, end_y = x + reach * (c * cosines - s * sines), y + reach * (s * cosines + c * sines)
        ends = np.floor(np.column_stack([end_y, end_x])).astype(np.int64)
        start = np.array([math.floor(y), math.floor(x)])
        rows, cols, beams, left = trace_beams(start, ends)

        probs = np.full(len(rows), params.empty_prob)
        hole = params.hole_width / self.resolution
        ramp = hits & (((ends - start) ** 2).sum(axis=1) > hole**2)
        last = np.flatnonzero((left <= hole) & ramp[beams])
        square = (rows[last] - ends[beams[last], 0]) ** 2 + (cols[last] - ends[beams[last], 1]) ** 2
        last, square = last[square < hole**2], square[square < hole**2]
        probs[last] = params.occupied_prob * (1.0 - square / hole**2)
        probs[(left == 0) & hits[beams]] = params.occupied_prob
        return self._average(rows, cols, 0.5 + (probs - 0.5) * quality)

    def _average(self, rows: np.ndarray, cols: np.ndarray, observed: np.ndarray) -> np.ndarray:
        """Take observations into the means of their cells; return the cells that became known."""
        height, width = self.shape
        inside = (rows > 0) & (rows < height - 1) & (cols > 0) & (cols < width - 1)
        cells = rows[inside] * width + cols[inside]
        sums, counts = self._sums.ravel(), self.counts.ravel()
        new = np.unique(cells[counts[cells] == 0])
        np.add.at(sums, cells, observed[inside])
        np.add.at(counts, cells, 1)
        self.values.ravel()[cells] = sums[cells] / counts[cells]
        return np.column_stack(np.divmod(new, width))
