"""Weighing particles by how near to the map's obstacles the scan ends: scan in, weigher out."""

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid, Pose2D
from envs.geometry.lookup import load
from envs.navigation.costmap import squared_distances
from envs.robots import LidarParams
from envs.slam.matcher import project_hits

from .motion_model import cosine, sine
from .params import AmclParams

OCCUPIED_FROM = 65
"""Least occupancy that is an obstacle [percent], as where maps are saved."""
ONE = 65535
"""Greatest entry of a field, which are 16-bit so that more of it stays in the cache, and sums are exact."""
MAX_REACH = 180
"""Cells over which distances can be computed."""


def obstacle_distances(obstacles: np.ndarray, resolution: float, max_distance: float) -> np.ndarray:
    """Measure how far cells lie from the nearest obstacle, centre to centre.

    Args:
        obstacles: shape (height, width), bool.
        resolution: side of a cell [m].
        max_distance: what lies farther counts as this far [m].

    Returns:
        Shape (height, width), float64 [m].

    Raises:
        ValueError: if `max_distance` spans too many cells.
    """
    reach = math.ceil(max_distance / resolution)
    if reach > MAX_REACH:
        raise ValueError(f"max_distance must span at most {MAX_REACH} cells, got {max_distance} m at {resolution} m")
    squared = squared_distances(obstacles, reach)
    return np.minimum(np.sqrt(np.arange(squared.max() + 1.0)) * resolution, max_distance)[squared]


@njit(cache=True, error_model="numpy", inline="always")
def sum_field(flat, width, points_x, points_y, x, y, c, s, cells):
    """Sum the field over the points as seen from one pose.

    Finding the cells first and reading them afterwards lets the first half vectorise; see `load` for the second.

    Args:
        flat: shape (height * width,), uint16, the field row by row, with a border that no point can leave.
        width: of the field, int32 [cells].
        points_x: shape (num_points,), float32, in the base frame [cells].
        points_y: shape (num_points,), float32, in the base frame [cells].
        x: position of the base from the field's corner, float32 [cells].
        y: position of the base from the field's corner, float32 [cells].
        c: cosine of its heading, float32.
        s: sine of its heading, float32.
        cells: shape (num_points,), uint32, scratch.
    """
    for k in range(cells.shape[0]):
        col = np.int32(c * points_x[k] - s * points_y[k] + x)
        row = np.int32(s * points_x[k] + c * points_y[k] + y)
        cells[k] = np.uint32(np.int32(row * width + col))
    total = np.int32(0)
    for k in range(cells.shape[0]):
        total += load(flat, cells[k])
    return total


@njit(cache=True, error_model="numpy")
def sum_fields(field, border, corner_x, corner_y, resolution, points, num_points, particles, sums):
    """Sum the field over the points as seen from every particle.

    Args:
        field: shape (height, width), uint16.
        border: width of the border that no point can leave from within [cells]; its entries are all the same.
        corner_x: where the field's corner lies in the map frame [m].
        corner_y: where the field's corner lies in the map frame [m].
        resolution: side of a cell [m].
        points: shape (2, >= num_points), float32, in the base frame [cells].
        num_points: number of points.
        particles: shape (3, n), float32, x, y, heading [m, rad].
        sums: shape (n,), int32, written. A particle outside the map sees no obstacle.
    """
    xs, ys, thetas = particles[0], particles[1], particles[2]
    count = xs.shape[0]
    cosines, sines = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
    for i in range(count):
        cosines[i] = cosine(thetas[i])
        sines[i] = sine(thetas[i])
    cells = np.empty(num_points, dtype=np.uint32)
    flat, width = field.ravel(), np.int32(field.shape[1])
    points_x, points_y = points[0, :num_points], points[1, :num_points]
    scale = np.float32(1.0 / resolution)
    offset_x, offset_y = np.float32(corner_x), np.float32(corner_y)
    low = np.float32(border)
    high_x, high_y = np.float32(field.shape[1] - border), np.float32(field.shape[0] - border)
    nothing = np.int32(num_points) * np.int32(field[0, 0])
    for i in range(count):
        x, y = (xs[i] - offset_x) * scale, (ys[i] - offset_y) * scale
        inside = x >= low and x < high_x and y >= low and y < high_y
        sums[i] = sum_field(flat, width, points_x, points_y, x, y, cosines[i], sines[i], cells) if inside else nothing


@njit(cache=True, error_model="numpy")
def multiply_by_sum(weights, sums, unit):
    """Multiply weights (n,), float64, by one plus the sums; return the weighted mean of those factors.

    The weight of the likelihood field as ROS has it: `1 + sum pz^3`.
    """
    level = 0.0
    for i in range(weights.shape[0]):
        factor = 1.0 + unit * sums[i]
        level += weights[i] * factor
        weights[i] *= factor
    return level


@njit(cache=True, error_model="numpy")
def multiply_by_product(weights, sums, unit, least, num_points, squash, needs_level):
    """Multiply weights (n,), float64, by the likelihoods whose logarithms are the sums, relative to the greatest.

    Returns:
        The weighted mean of the likelihoods' geometric means over the beams, if it is needed. Those themselves would
        jump by powers of ten from one scan to the next.
    """
    best = sums.max()
    level = 0.0
    for i in range(weights.shape[0]):
        if needs_level:
            level += weights[i] * math.exp(least + unit * sums[i] / num_points)
        weights[i] *= math.exp(np.float32(unit / squash) * np.float32(sums[i] - best))
    return level


@njit(cache=True, error_model="numpy")
def count_near(field, near, points, num_points, x, y, theta):
    """Count the points, shape (2, >= num_points) [cells], where the field is at least `near`, as seen from a pose."""
    height, width = field.shape
    c, s = math.cos(theta), math.sin(theta)
    count = 0
    for k in range(num_points):
        col = math.floor(c * points[0, k] - s * points[1, k] + x)
        row = math.floor(s * points[0, k] + c * points[1, k] + y)
        if row >= 0 and col >= 0 and row < height and col < width and field[row, col] >= near:
            count += 1
    return count


class LikelihoodField:
    """Both likelihood fields: `likelihood_field` sums over beams, `likelihood_field_prob` multiplies.

    The likelihood of a hit at the distance d from the nearest obstacle is
    `pz = z_hit exp(-d^2 / (2 sigma_hit^2)) + z_rand / range_max`. A field holds `pz^3` or `log pz` for every cell, so
    that nothing is computed per beam and particle but the cell.
    """

    def __init__(self, params: AmclParams, lidar: LidarParams, occupancy: OccupancyGrid) -> None:
        """Prepare for a map.

        Args:
            params: how likely what is.
            lidar: geometry of the scans.
            occupancy: the map.
        """
        self._is_product = params.sensor == "likelihood_field_prob"
        self._squash = params.squash
        self.needs_level = params.alpha_slow > 0.0
        resolution = occupancy.resolution
        range_max = min(params.max_range or math.inf, lidar.range_max)
        self.beams = Beams(params, lidar, resolution)
        reach = math.ceil((range_max + math.hypot(lidar.mount.x, lidar.mount.y)) / resolution) + 2
        far = math.ceil(params.max_distance / resolution) + 1
        obstacles = np.pad(occupancy.data >= OCCUPIED_FROM, far)
        distances = obstacle_distances(obstacles, resolution, params.max_distance)

        def pz(distance: np.ndarray | float) -> np.ndarray:
            near = np.exp(-np.square(distance) / (2.0 * params.sigma_hit**2))
            return np.asarray(params.z_hit * near + params.z_rand / range_max)

        def likelihood(distance: np.ndarray | float) -> np.ndarray:
            return np.log(pz(distance)) if self._is_product else pz(distance) ** 3

        self.least = float(likelihood(params.max_distance)) if self._is_product else 0.0
        self.unit = max((float(likelihood(0.0)) - self.least) / ONE, 1e-12)

        def entry(distance: np.ndarray | float) -> np.ndarray:
            return np.rint((likelihood(distance) - self.least) / self.unit).astype(np.uint16)

        self.border = max(reach, far)
        self.field = np.pad(entry(distances), self.border - far, constant_values=entry(params.max_distance))
        self.near = int(entry(min(params.lost_distance, params.max_distance)))
        x, y = occupancy.origin
        self.corner = x - self.border * resolution, y - self.border * resolution
        self.resolution = resolution
        self._sums = np.empty(params.most_particles, dtype=np.int32)

    def __call__(self, ranges: np.ndarray) -> Callable[[np.ndarray, np.ndarray], float] | None:
        """Return what weighs particles by a scan.

        Args:
            ranges: shape (num_beams,), float32 [m].

        Returns:
            A weigher, which multiplies the weights, shape (n,), float64, of particles, shape (3, n), float32, by
            likelihoods up to a common factor, and returns their mean. None if no beam has hit anything.
        """
        points, count = self.beams.hits(ranges)
        if count == 0:
            return None

        def weigh(particles: np.ndarray, weights: np.ndarray) -> float:
            sums = self._sums[: len(weights)]
            sum_fields(self.field, self.border, *self.corner, self.resolution, points, count, particles, sums)
            if self._is_product:
                return multiply_by_product(weights, sums, self.unit, self.least, count, self._squash, self.needs_level)
            return multiply_by_sum(weights, sums, self.unit)

        return weigh

    def fit(self, ranges: np.ndarray, pose: Pose2D) -> tuple[float, int]:
        """Return the share of a scan's hits that lie near an obstacle as seen from a pose, and the number of hits."""
        points, count = self.beams.hits(ranges)
        if count == 0:
            return 0.0, 0
        x, y = ((place - corner) / self.resolution for place, corner in zip(pose, self.corner))
        near = count_near(self.field, self.near, points, count, x, y, pose.theta)
        return near / count, count


class Beams:
    """Which beams of a scan are used, and where they end."""

    def __init__(self, params: AmclParams, lidar: LidarParams, resolution: float) -> None:
        step = max(1, (lidar.num_beams - 1) // max(params.max_beams - 1, 1))
        self.picked = slice(0, step * (params.max_beams - 1) + 1, step)
        angles = lidar.angles[self.picked] + lidar.mount.yaw
        self.directions = np.stack([np.cos(angles), np.sin(angles)])
        self.range_max = min(params.max_range or math.inf, lidar.range_max)
        self._mount = lidar.mount
        self._resolution = resolution
        self._points = np.empty((2, len(angles)), dtype=np.float32)

    def hits(self, ranges: np.ndarray) -> tuple[np.ndarray, int]:
        """Return where beams end, shape (2, >= count), float32, base frame [cells], and the count of those that do."""
        picked = np.ascontiguousarray(ranges[self.picked])
        count = project_hits(
            picked, self.range_max, self.directions, self._mount.x, self._mount.y, self._resolution, self._points
        )
        return self._points, count
