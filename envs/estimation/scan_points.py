"""Scans as points: beam ends in the base frame, returns, and points on bodies such as people, compiled with Numba."""

from functools import lru_cache
from typing import NamedTuple, Self

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import LidarParams

BODY_MARGIN = 0.15
"""Margin around outlines of people and other robots [m]. Beams that end inside hit that body."""


class ScanGeometry(NamedTuple):
    """Lidar beam geometry and unit of points."""

    directions: np.ndarray
    """Cosine and sine of beam directions in the base frame, shape (2, num_beams), float64."""
    mount_x: float
    """Lidar position along x in the base frame [m]."""
    mount_y: float
    range_max: float
    """Maximum range [m]; readings from this range on mean no return."""
    resolution: float = 1.0
    """Unit of points [m]: side of a map cell, or 1 for metres."""
    skip_exceeding: bool = False

    @classmethod
    @lru_cache(maxsize=64)
    def of(cls, lidar: LidarParams, resolution: float = 1.0, skip_exceeding: bool = False) -> Self:
        mount = float(lidar.mount.x), float(lidar.mount.y)
        return cls(lidar.directions, *mount, float(lidar.range_max), float(resolution), skip_exceeding)


@njit(cache=True, error_model="numpy")
def beam_end(r, k, geometry):
    """Return the point (x, y) at range `r` [m] on beam `k`, base frame [m]."""
    return geometry.mount_x + r * geometry.directions[0, k], geometry.mount_y + r * geometry.directions[1, k]


@njit(cache=True, error_model="numpy")
def scan_ends(ranges, geometry):
    """Return the ends of all beams, shape (num_beams, 2), float64, base frame [m]; not finite without a return."""
    ends = np.empty((ranges.shape[0], 2))
    for k in range(ranges.shape[0]):
        ends[k, 0], ends[k, 1] = beam_end(ranges[k], k, geometry)
    return ends


@njit(cache=True, error_model="numpy")
def project_hits(ranges, geometry, points):
    """Convert a scan to points, base frame, in units of `geometry.resolution`; return the number of points.

    `ranges`: shape (num_beams,), float32 [m]; values in (0, range_max) give points. `points` receives them, shape (2,
    num_beams).
    """
    count, scale = 0, 1.0 / geometry.resolution
    for k in range(ranges.shape[0]):
        if 0.0 < ranges[k] < geometry.range_max:
            x, y = beam_end(ranges[k], k, geometry)
            points[0, count], points[1, count] = scale * x, scale * y
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def is_on_body(x, y, bodies, margin):
    """Return True if a point is within `margin` [m] of the outline of a body.

    `bodies`: people or robots as x, y, vx, vy, radius, shape (n, 5) [m, m/s].
    """
    is_on = False
    for i in range(bodies.shape[0]):
        dx, dy, reach = x - bodies[i, 0], y - bodies[i, 1], bodies[i, 4] + margin
        is_on |= dx * dx + dy * dy <= reach * reach
    return is_on


@njit(cache=True, error_model="numpy")
def are_on_bodies(points, bodies, margin):
    """Return the mask of points, shape (n, 2), on bodies, see `is_on_body`: shape (n,), bool."""
    mask = np.empty(points.shape[0], dtype=np.bool_)
    for k in range(points.shape[0]):
        mask[k] = is_on_body(points[k, 0], points[k, 1], bodies, margin)
    return mask


def without_bodies(points: np.ndarray, bodies: np.ndarray) -> np.ndarray:
    """Return the points, shape (n, 2), farther than `BODY_MARGIN` from bodies: shape (k, 2) [m]."""
    return points[~are_on_bodies(points, bodies, BODY_MARGIN)]


def as_bodies(pose: Pose2D, peers: list[Pose2D], radius: float) -> np.ndarray:
    """Return other robots as bodies at rest in the frame of `pose`: x, y, vx, vy, radius, shape (n, 5) [m, m/s]."""
    positions = pose.inverse().transform(np.array([peer[:2] for peer in peers]))
    return np.column_stack([positions, np.zeros_like(positions), np.full(len(peers), radius)])
