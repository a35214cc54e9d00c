"""Beam sensor model: particles are weighted by casting the beams through the map."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry import UNKNOWN, OccupancyGrid
from envs.robots import LidarParams

from .beams import Beams
from .likelihood_field import OCCUPIED_FROM, obstacle_distances
from .motion_model import cosine, sine
from .params import AmclParams

_STEP = np.float32(0.5)
"""Shortest step of a ray [cells]; obstacles cut by less than this may be missed."""
_MARGIN = np.float32(1.42)
"""By how much the distance of two cells' centres may exceed that of two points in them [cells]."""


@njit(cache=True, error_model="numpy")
def march(distances, x, y, dx, dy, longest):
    """Follow a ray to the first obstacle, in steps as long as it is certainly clear (sphere tracing).

    Args:
        distances: shape (height, width), float32, from each cell to the nearest obstacle, 0 in it [cells].
        x: start, float32 [cells].
        y: start, float32 [cells].
        dx: direction, float32, of length 1.
        dy: direction, float32.
        longest: end of the ray, float32 [cells].

    Returns:
        Distance to the obstacle; `longest` if there is none, or the ray leaves the map [cells].
    """
    height, width = np.float32(distances.shape[0]), np.float32(distances.shape[1])
    travelled = np.float32(0.0)
    while travelled < longest:
        col, row = x + travelled * dx, y + travelled * dy
        if not (col >= np.float32(0.0) and row >= np.float32(0.0) and col < width and row < height):
            return longest
        distance = distances[np.int32(row), np.int32(col)]
        if distance <= np.float32(0.0):
            return travelled
        travelled += max(distance - _MARGIN, _STEP)
    return longest


class BeamMixture(NamedTuple):
    """Weights and shapes of the components of a reading's likelihood, as in `AmclParams`."""

    z_hit: float
    z_short: float
    z_max: float
    z_rand: float
    sigma_hit: float
    lambda_short: float


class RayMap(NamedTuple):
    """A map to cast rays in."""

    distances: np.ndarray
    """Shape (height, width), float32: see `march` [cells]."""
    origin: tuple[float, float]
    """Corner of the map in the map frame [m]."""
    resolution: float
    """Side of a cell [m]."""


class Scan(NamedTuple):
    """Readings and the geometry of their beams."""

    ranges: np.ndarray
    """Shape (k,), float32 [m]; inf for no return, NaN for a beam to ignore."""
    angles: np.ndarray
    """Shape (k,), float64, directions in the base frame [rad]."""
    mount: tuple[float, float]
    """Position of the lidar in the base frame [m]."""
    range_max: float
    """Readings from this on are no return [m]."""


@njit(cache=True, error_model="numpy")
def beam_likelihood(measured, expected, range_max, mixture):
    """Return the likelihood of a reading [m]: the mixture of Thrun et al. 2005, table 6.1, as ROS computes it."""
    error = measured - expected
    p = mixture.z_hit * math.exp(-error * error / (2.0 * mixture.sigma_hit * mixture.sigma_hit))
    if error < 0.0:
        p += mixture.z_short * mixture.lambda_short * math.exp(-mixture.lambda_short * measured)
    if measured >= range_max:
        p += mixture.z_max
    else:
        p += mixture.z_rand / range_max
    return p


@njit(cache=True, error_model="numpy")
def multiply_by_beams(ray_map, scan, mixture, particles, weights):
    """Multiply weights, shape (n,), float64, of particles by `1 + sum p^3` over the beams.

    Args:
        ray_map: `RayMap`.
        scan: `Scan`.
        mixture: `BeamMixture`.
        particles: shape (3, n), float32, x, y, heading [m, rad].
        weights: changed in place.

    Returns:
        The weighted mean of the factors.
    """
    num_beams, resolution = scan.ranges.shape[0], ray_map.resolution
    (corner_x, corner_y), (mount_x, mount_y) = ray_map.origin, scan.mount
    cosines, sines = np.cos(scan.angles).astype(np.float32), np.sin(scan.angles).astype(np.float32)
    longest = np.float32(scan.range_max / resolution)
    mean = 0.0
    for i in range(weights.shape[0]):
        c, s = cosine(particles[2, i]), sine(particles[2, i])
        x = np.float32((particles[0, i] + c * mount_x - s * mount_y - corner_x) / resolution)
        y = np.float32((particles[1, i] + s * mount_x + c * mount_y - corner_y) / resolution)
        factor = 1.0
        for k in range(num_beams):
            if math.isnan(scan.ranges[k]):
                continue
            dx, dy = c * cosines[k] - s * sines[k], s * cosines[k] + c * sines[k]
            expected = resolution * march(ray_map.distances, x, y, dx, dy, longest)
            measured = min(float(scan.ranges[k]), scan.range_max)
            p = beam_likelihood(measured, expected, scan.range_max, mixture)
            factor += p * p * p
        mean += weights[i] * factor
        weights[i] *= factor
    return mean


class BeamModel:
    """The sensor model `beam`. Rays end at obstacles and at unknown cells, as in ROS."""

    def __init__(self, params: AmclParams, lidar: LidarParams, occupancy: OccupancyGrid) -> None:
        """Precompute the distances of a map.

        Args:
            params: of the filter.
            lidar: geometry of the scans.
            occupancy: the map.
        """
        self._beams = Beams(params, lidar, occupancy.resolution)
        self._mixture = BeamMixture(*(getattr(params, field) for field in BeamMixture._fields))
        blocked = (occupancy.data >= OCCUPIED_FROM) | (occupancy.data == UNKNOWN)
        distances = obstacle_distances(blocked, occupancy.resolution, params.max_distance)
        distances = (distances / occupancy.resolution).astype(np.float32)
        self._ray_map = RayMap(distances, occupancy.origin, occupancy.resolution)

    def __call__(self, ranges: np.ndarray) -> Callable[[np.ndarray, np.ndarray], float] | None:
        """Return the weighting function of a scan; see `LikelihoodField`. None if all beams are to be ignored."""
        beams = self._beams
        scan = Scan(beams.pick(ranges), beams.angles, beams.mount, beams.range_max)
        if np.isnan(scan.ranges).all():
            return None

        def weigh(particles: np.ndarray, weights: np.ndarray) -> float:
            return multiply_by_beams(self._ray_map, scan, self._mixture, particles, weights)

        return weigh
