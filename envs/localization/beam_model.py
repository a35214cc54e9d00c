"""Beam sensor model: weights particles by ray casting."""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import UNKNOWN, OccupancyGrid
from lidarnaut.envs.robots import LidarParams

from .amcl_params import AmclParams
from .likelihood_field import Beams, Field, obstacle_distances
from .motion_model import cosine, sine

_MIN_STEP = np.float32(0.5)
"""Minimum step of ray casting [cells]."""
_CELL_DIAGONAL = np.float32(1.42)


@njit(cache=True, error_model="numpy")
def march(distances, x, y, dx, dy, longest):
    """Return the range from grid position (x, y) to the first obstacle in direction (dx, dy), by sphere tracing.

    Lengths are float32 [cells]. `distances`: distance of cells to the nearest obstacle, shape (height, width).
    `longest`: maximum range.
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
        travelled += max(distance - _CELL_DIAGONAL, _MIN_STEP)
    return longest


class BeamMixture(NamedTuple):
    """Mixture weights and shape parameters of the beam sensor model, see `AmclParams`."""

    z_hit: float
    z_short: float
    z_max: float
    z_rand: float
    sigma_hit: float
    lambda_short: float


@njit(cache=True, error_model="numpy")
def beam_likelihood(measured, expected, range_max, mixture):
    """Return the likelihood of a `measured` range given the `expected` range [m] (Thrun et al. 2005, table 6.1)."""
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
def multiply_by_beams(field, ranges, geometry, mixture, particles, weights):
    """Multiply particle weights by `1 + sum p^3` over beams of likelihood p, as in ROS; return the mean factor.

    `field`: grid of distances to the nearest obstacle [cells]. `ranges`: shape (k,), float32 [m], NaN for ignored
    beams. `particles`: x, y, heading, shape (3, n), float32 [m, m, rad].
    """
    resolution, (corner_x, corner_y) = field.resolution, field.origin
    mount_x, mount_y, range_max = geometry.mount_x, geometry.mount_y, geometry.range_max
    cosines, sines = geometry.directions[0].astype(np.float32), geometry.directions[1].astype(np.float32)
    longest = np.float32(min(range_max / resolution, 2.0**23))  # float32 holds no half cells beyond
    mean = 0.0
    for i in range(weights.shape[0]):
        c, s = cosine(particles[2, i]), sine(particles[2, i])
        x = np.float32((particles[0, i] + c * mount_x - s * mount_y - corner_x) / resolution)
        y = np.float32((particles[1, i] + s * mount_x + c * mount_y - corner_y) / resolution)
        factor = 1.0
        for k in range(ranges.shape[0]):
            if math.isnan(ranges[k]):
                continue
            dx, dy = c * cosines[k] - s * sines[k], s * cosines[k] + c * sines[k]
            expected = resolution * march(field.data, x, y, dx, dy, longest)
            p = beam_likelihood(min(float(ranges[k]), range_max), expected, range_max, mixture)
            factor += p * p * p
        mean += weights[i] * factor
        weights[i] *= factor
    return mean


class BeamModel:
    """Beam sensor model of AMCL. Ray casting stops at occupied and unknown cells, as in ROS."""

    def __init__(self, params: AmclParams, lidar: LidarParams, occupancy: OccupancyGrid) -> None:
        resolution = occupancy.resolution
        self._beams = Beams(params, lidar, resolution)
        self._mixture = BeamMixture(*(getattr(params, field) for field in BeamMixture._fields))
        blocked = occupancy.occupied | (occupancy.data == UNKNOWN)
        distances = obstacle_distances(blocked, resolution, params.max_distance) / resolution
        self._field = Field(distances.astype(np.float32), 0, occupancy.origin, resolution)

    def __call__(self, ranges: np.ndarray) -> Callable[[np.ndarray, np.ndarray], float] | None:
        """Return a function that multiplies particle weights by the likelihood of a scan; None without valid beams."""
        picked = self._beams.pick(ranges)
        if np.isnan(picked).all():
            return None
        return partial(multiply_by_beams, self._field, picked, self._beams.geometry, self._mixture)
