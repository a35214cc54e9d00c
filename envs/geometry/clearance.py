"""Distances from points to segments and circles."""

import math

import numpy as np

from lidarnaut.envs.compilation import njit


@njit(cache=True, error_model="numpy", inline="always")
def segment_offset(x, y, segments, i):
    """Return the vector from the nearest point of line segment `i` to the point (x, y) [m]."""
    x0, y0 = segments[i, 0], segments[i, 1]
    ex, ey = segments[i, 2] - x0, segments[i, 3] - y0
    px, py = x - x0, y - y0
    t = min(max((px * ex + py * ey) / max(ex * ex + ey * ey, 1e-300), 0.0), 1.0)
    return px - t * ex, py - t * ey


@njit(cache=True, error_model="numpy")
def clearance(x, y, segments, circles):
    """Return the distance from (x, y) to the nearest obstacle [m]: negative inside a circle, inf without obstacles.

    `segments`: walls (x0, y0, x1, y1), shape (n, 4), float64 [m]. `circles`: (x, y, radius), shape (m, 3), float64 [m].
    """
    nearest2 = np.inf
    for i in range(segments.shape[0]):
        dx, dy = segment_offset(x, y, segments, i)
        nearest2 = min(nearest2, dx * dx + dy * dy)
    nearest = math.sqrt(nearest2)
    for i in range(circles.shape[0]):
        nearest = min(nearest, math.hypot(x - circles[i, 0], y - circles[i, 1]) - circles[i, 2])
    return nearest
