"""Weighing particles by casting the beams through the map: scan in, weigher out."""

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from envs.geometry import UNKNOWN, OccupancyGrid
from envs.robots import LidarParams

from .likelihood_field import OCCUPIED_FROM, Beams, obstacle_distances
from .motion_model import cosine, sine
from .params import AmclParams

_STEP = np.float32(0.5)
"""Shortest step of a ray [cells]; what sticks out into the ray by less may be missed."""
_SURE = np.float32(1.42)
"""By how much a cell's centre may be farther from an obstacle's than two points in the two cells are [cells]."""


@njit(cache=True, error_model="numpy")
def march(distances, x, y, dx, dy, longest):
    """Walk along a ray to the first obstacle, each time as far as none can be.

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
    way = np.float32(0.0)
    while way < longest:
        col, row = x + way * dx, y + way * dy
        if not (col >= np.float32(0.0) and row >= np.float32(0.0) and col < width and row < height):
            return longest
        distance = distances[np.int32(row), np.int32(col)]
        if distance <= np.float32(0.0):
            return way
        way += max(distance - _SURE, _STEP)
    return longest


@njit(cache=True, error_model="numpy")
def beam_likelihood(measured, expected, range_max, z_hit, z_short, z_max, z_rand, sigma_hit, lambda_short):
    """Return the likelihood of a reading: the mixture of Thrun et al. 2005, table 6.1, as ROS computes it [m]."""
    error = measured - expected
    p = z_hit * math.exp(-error * error / (2.0 * sigma_hit * sigma_hit))
    if error < 0.0:
        p += z_short * lambda_short * math.exp(-lambda_short * measured)
    if measured >= range_max:
        p += z_max
    else:
        p += z_rand / range_max
    return p


@njit(cache=True, error_model="numpy")
def multiply_by_beams(
    distances, corner_x, corner_y, resolution, ranges, angles, mount_x, mount_y, range_max, mixture, particles, weights
):
    """Multiply weights (n,), float64, of particles (3, n), float32, by `1 + sum p^3` over the beams.

    Args:
        distances: see `march`.
        corner_x: where the map's corner lies in the map frame [m].
        corner_y: where the map's corner lies in the map frame [m].
        resolution: side of a cell [m].
        ranges: shape (k,), float32 [m]; inf for no return, NaN for a beam to ignore.
        angles: shape (k,), float64, of the beams in the base frame [rad].
        mount_x: where the lidar sits in the base frame [m].
        mount_y: where the lidar sits in the base frame [m].
        range_max: from where on a reading is no return [m].
        mixture: z_hit, z_short, z_max, z_rand, sigma_hit [m], lambda_short [1/m].
        particles: x, y, heading [m, rad].
        weights: changed in place.

    Returns:
        The weighted mean of the factors.
    """
    num_beams = ranges.shape[0]
    cosines, sines = np.cos(angles).astype(np.float32), np.sin(angles).astype(np.float32)
    z_hit, z_short, z_max, z_rand, sigma_hit, lambda_short = mixture
    longest = np.float32(range_max / resolution)
    level = 0.0
    for i in range(weights.shape[0]):
        c, s = cosine(particles[2, i]), sine(particles[2, i])
        x = np.float32((particles[0, i] + c * mount_x - s * mount_y - corner_x) / resolution)
        y = np.float32((particles[1, i] + s * mount_x + c * mount_y - corner_y) / resolution)
        factor = 1.0
        for k in range(num_beams):
            if math.isnan(ranges[k]):
                continue
            dx, dy = c * cosines[k] - s * sines[k], s * cosines[k] + c * sines[k]
            expected = resolution * march(distances, x, y, dx, dy, longest)
            measured = min(float(ranges[k]), range_max)
            p = beam_likelihood(measured, expected, range_max, z_hit, z_short, z_max, z_rand, sigma_hit, lambda_short)
            factor += p * p * p
        level += weights[i] * factor
        weights[i] *= factor
    return level


class BeamModel:
    """The sensor model `beam`. Rays end at obstacles and at cells that nobody has seen, as in ROS."""

    def __init__(self, params: AmclParams, lidar: LidarParams, occupancy: OccupancyGrid) -> None:
        """Prepare for a map.

        Args:
            params: how likely what is.
            lidar: geometry of the scans.
            occupancy: the map.
        """
        self._beams = Beams(params, lidar, occupancy.resolution)
        self._mount = lidar.mount
        self._angles = lidar.angles[self._beams.picked] + lidar.mount.yaw
        self._mixture = (
            *(params.z_hit, params.z_short, params.z_max, params.z_rand),
            *(params.sigma_hit, params.lambda_short),
        )
        blocked = (occupancy.data >= OCCUPIED_FROM) | (occupancy.data == UNKNOWN)
        distances = obstacle_distances(blocked, occupancy.resolution, params.max_distance)
        self._distances = (distances / occupancy.resolution).astype(np.float32)
        self._corner = occupancy.origin
        self._resolution = occupancy.resolution

    def __call__(self, ranges: np.ndarray) -> Callable[[np.ndarray, np.ndarray], float] | None:
        """Return what weighs particles by a scan; see `LikelihoodField`. None if all beams are to be ignored."""
        picked = np.ascontiguousarray(ranges[self._beams.picked])
        if np.isnan(picked).all():
            return None

        def weigh(particles: np.ndarray, weights: np.ndarray) -> float:
            return multiply_by_beams(
                *(self._distances, *self._corner, self._resolution, picked, self._angles),
                *(self._mount.x, self._mount.y, self._beams.range_max, self._mixture, particles, weights),
            )

        return weigh
