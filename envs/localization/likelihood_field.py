"""Likelihood field sensor models: weight particles by distances from beam end points to mapped obstacles."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation.scan_points import ScanGeometry, project_hits
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.distance_transform import MAX_REACH, squared_distances
from lidarnaut.envs.geometry.lookup import load
from lidarnaut.envs.robots import LidarParams

from .amcl_params import AmclParams
from .motion_model import cosine, sine

MAX_ENTRY = 65535
"""Maximum cell value of a likelihood field (16-bit integers)."""


class Beams:
    """Evenly spaced lidar beams that a sensor model uses."""

    def __init__(self, params: AmclParams, lidar: LidarParams, resolution: float) -> None:
        step = max(1, (lidar.num_beams - 1) // max(params.max_beams - 1, 1))
        self._picked = slice(0, step * (params.max_beams - 1) + 1, step)
        self.geometry = ScanGeometry.of(lidar, resolution)._replace(
            directions=np.ascontiguousarray(lidar.directions[:, self._picked]),
            range_max=float(min(params.max_range or math.inf, lidar.range_max)),
        )

    def pick(self, ranges: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(ranges[self._picked])

    def hits(self, ranges: np.ndarray) -> tuple[np.ndarray, int]:
        """Return beam end points, base frame [cells]: first columns of an array, shape (2, n), and their number."""
        points = np.empty((2, self.geometry.directions.shape[1]), dtype=np.float32)
        return points, project_hits(self.pick(ranges), self.geometry, points)


def obstacle_distances(obstacles: np.ndarray, resolution: float, max_distance: float) -> np.ndarray:
    """Return each cell's distance to the nearest obstacle, at most `max_distance`, shape (height, width), float64 [m].

    `obstacles`: True for occupied cells, shape (height, width).
    """
    if not obstacles.any():
        return np.full(obstacles.shape, max_distance)
    reach = math.ceil(max_distance / resolution)
    if 1 <= reach <= MAX_REACH:
        distances = np.sqrt(squared_distances(obstacles, reach), dtype=np.float64)
    else:
        distances = ndimage.distance_transform_edt(~obstacles)
    distances *= resolution  # in place: large maps with a margin have many cells
    return np.minimum(distances, max_distance, out=distances)


class Field(NamedTuple):
    """Map grid with likelihoods of beam end points, or distances to the nearest obstacle."""

    data: np.ndarray
    """Likelihoods scaled to 0 to 65535, uint16, or distances to the nearest obstacle, float32 [cells]: shape (height,
    width)."""
    border: int
    """Width of the margin around the map for beams that end outside [cells]; 0 for a grid of distances."""
    origin: tuple[float, float]
    """Minimum x and y of the grid, relative to the map's corner [m]."""
    resolution: float


@njit(cache=True, error_model="numpy")
def sum_fields(field, points, num_points, particles, sums):
    """Sum the likelihood field values at a scan's beam end points, for each particle.

    `points`: end points, shape (2, >= num_points), base frame [cells]. `particles`: x, y, heading, shape (3, n),
    float32 [m, m, rad]. `sums`: output, shape (n,), int32.
    """
    xs, ys, thetas = particles[0], particles[1], particles[2]
    count = xs.shape[0]
    cosines, sines = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
    for i in range(count):
        cosines[i] = cosine(thetas[i])
        sines[i] = sine(thetas[i])
    cells = np.empty(num_points, dtype=np.uint32)
    flat, width = field.data.ravel(), np.int32(field.data.shape[1])
    points_x, points_y = points[0, :num_points], points[1, :num_points]
    scale = np.float32(1.0 / field.resolution)
    offset_x, offset_y = np.float32(field.origin[0]), np.float32(field.origin[1])
    low = np.float32(field.border)
    high_x, high_y = np.float32(field.data.shape[1] - field.border), np.float32(field.data.shape[0] - field.border)
    nothing = np.int32(num_points) * np.int32(field.data[0, 0])
    for i in range(count):
        x, y = (xs[i] - offset_x) * scale, (ys[i] - offset_y) * scale
        if not (x >= low and x < high_x and y >= low and y < high_y):
            sums[i] = nothing
            continue
        c, s = cosines[i], sines[i]
        for k in range(num_points):
            col = np.int32(c * points_x[k] - s * points_y[k] + x)
            row = np.int32(s * points_x[k] + c * points_y[k] + y)
            cells[k] = np.uint32(np.int32(row * width + col))
        total = np.int32(0)
        for k in range(num_points):
            total += load(flat, cells[k])
        sums[i] = total


@njit(cache=True, error_model="numpy")
def multiply_by_product(weights, sums, unit, least, num_points, squash, needs_mean):
    """Multiply particle weights, shape (n,), by scan likelihoods, up to a common factor; return the mean likelihood.

    `sums`: sum of scaled log-likelihoods over beams, per particle. The mean is geometric over beams, and weighted over
    particles; 0 without `needs_mean`.
    """
    best = sums.max()
    mean = 0.0
    for i in range(weights.shape[0]):
        if needs_mean:
            mean += weights[i] * math.exp(least + unit * sums[i] / num_points)
        weights[i] *= math.exp(np.float32(unit / squash) * np.float32(sums[i] - best))
    return mean


@njit(cache=True, error_model="numpy")
def count_near(field, near, points, num_points, pose):
    """Count beam end points in cells with a likelihood field value of at least `near`, for a pose (x, y, heading)."""
    height, width = field.data.shape
    x, y = (pose[0] - field.origin[0]) / field.resolution, (pose[1] - field.origin[1]) / field.resolution
    c, s = math.cos(pose[2]), math.sin(pose[2])
    count = 0
    for k in range(num_points):
        col = math.floor(c * points[0, k] - s * points[1, k] + x)
        row = math.floor(s * points[0, k] + c * points[1, k] + y)
        if row >= 0 and col >= 0 and row < height and col < width and field.data[row, col] >= near:
            count += 1
    return count


class LikelihoodField:
    """Likelihood field sensor models: `likelihood_field` sums beam likelihoods, `likelihood_field_prob` multiplies.

    The likelihood of a beam that ends at distance d from the nearest obstacle is `pz = z_hit exp(-d^2 / (2
    sigma_hit^2)) + z_rand / range_max` (Thrun et al. 2005, table 6.3). Cells store `pz^3` or `log pz`.
    """

    def __init__(self, params: AmclParams, lidar: LidarParams, occupancy: OccupancyGrid) -> None:
        self._is_product = params.sensor == "likelihood_field_prob"
        self._squash = params.squash
        self._needs_mean = params.alpha_slow > 0.0
        resolution = occupancy.resolution
        self.beams = Beams(params, lidar, resolution)
        range_max = self.beams.geometry.range_max
        reach = math.ceil((range_max + math.hypot(lidar.mount.x, lidar.mount.y)) / resolution) + 2
        far = math.ceil(params.max_distance / resolution) + 1

        def likelihood(distance: np.ndarray | float) -> np.ndarray:
            hit = np.exp(-np.square(distance) / (2.0 * params.sigma_hit**2))
            pz = np.asarray(params.z_hit * hit + params.z_rand / range_max)
            return np.log(pz) if self._is_product else pz**3

        self._least = float(likelihood(params.max_distance)) if self._is_product else 0.0
        self._unit = max((float(likelihood(0.0)) - self._least) / MAX_ENTRY, 1e-12)

        def entry(distance: np.ndarray | float) -> np.ndarray:
            return np.rint((likelihood(distance) - self._least) / self._unit).astype(np.uint16)

        obstacles = np.pad(occupancy.occupied, far)
        distances = obstacle_distances(obstacles, resolution, params.max_distance)
        # By rows, as temporary arrays of large maps are slow.
        values = np.array([entry(row) for row in distances])
        border = max(reach, far)
        values = np.pad(values, border - far, constant_values=entry(params.max_distance))
        x, y = occupancy.origin
        self.table = Field(values, border, (x - border * resolution, y - border * resolution), resolution)
        self._near = int(entry(min(params.lost_distance, params.max_distance)))

    def __call__(self, ranges: np.ndarray) -> Callable[[np.ndarray, np.ndarray], float] | None:
        """Return a function that multiplies particle weights by the likelihood of a scan; None if no beam returns.

        The function takes particles, shape (3, n), and weights, shape (n,), and returns the mean likelihood.
        """
        points, count = self.beams.hits(ranges)
        if count == 0:
            return None

        def weigh(particles: np.ndarray, weights: np.ndarray) -> float:
            sums = np.empty(len(weights), dtype=np.int32)
            sum_fields(self.table, points, count, particles, sums)
            if self._is_product:
                return multiply_by_product(
                    weights, sums, self._unit, self._least, count, self._squash, self._needs_mean
                )
            weights *= 1.0 + self._unit * sums  # as in ROS
            return float(weights.sum())

        return weigh

    def fit(self, ranges: np.ndarray, pose: Pose2D) -> tuple[float, int]:
        """Return the share of beam end points near mapped obstacles at a pose, and the number of end points."""
        points, count = self.beams.hits(ranges)
        if count == 0:
            return 0.0, 0
        return count_near(self.table, self._near, points, count, pose) / count, count
