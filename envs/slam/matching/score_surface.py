"""Covariance of a match from the scores around it.

Olson, Real-time correlative scan matching, 2009, section III.C: scores at poses around the optimum are taken for the
logarithm of a likelihood, and its second moments are the covariance. A match that can slide, as along a corridor,
scores alike wherever it slides to, and gets a long ellipse; the curvature at the optimum alone would not show that.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry.lookup import load

from .pyramid import FULL

MAX_SHARE = 0.99
"""Variances above this share of a flat surface's are taken for it."""


class SurfaceParams(NamedTuple):
    """How scores around a match are evaluated, and what they mean."""

    half_width: float = 1.0
    """Largest offset along x and along y [m]."""
    step: float = 0.1
    """Distance between positions [m]; at best twice the side of a cell."""
    num_turns: int = 2
    """Headings on each side of the match."""
    turn_step: float = 0.02
    """Distance between headings [rad]."""
    point_step: int = 4
    """Every so many points are scored."""
    temperature: float = 0.03
    """Difference of scores that makes a pose less likely by a factor of e."""
    grid_sigma_xy: float = 0.06
    """Standard deviation that comes of the steps alone [m]; it is subtracted."""
    grid_sigma_theta: float = 0.015
    """The same of the heading [rad]."""
    least_sigma_xy: float = 0.03
    """Standard deviation of a match that cannot slide [m]; it is added."""
    least_sigma_theta: float = 0.008
    """The same of the heading [rad]."""


@njit(cache=True, error_model="numpy")
def surface_scores(pyramid, points, pose, params):
    """Score the poses around a match.

    Scores are taken from level 1 of the pyramid, the maxima of 2 x 2 cells: walls one cell thick would fall between
    positions two cells apart.

    Args:
        pyramid: `Pyramid` of the submap's field, of at least two levels.
        points: shape (n, 2), float32, hits in the base frame [m].
        pose: x, y, heading of the match in the submap's frame [m, m, rad].
        params: `SurfaceParams`.

    Returns:
        Shape (num_headings, num_rows, num_columns), float64, from 0 to 1, the match in the middle.

    Raises:
        ValueError: the offsets are larger than the pyramid was built for.
    """
    resolution = pyramid.resolution
    stride = max(round(params.step / resolution), 1)
    reach = round(params.half_width / (stride * resolution))
    if reach * stride > pyramid.reach:
        raise ValueError("the surface is wider than the pyramid was built for")
    level = pyramid.levels[1].ravel()
    height, width = pyramid.levels.shape[1], pyramid.levels.shape[2]
    num_points = (points.shape[0] + params.point_step - 1) // params.point_step
    scores = np.zeros((2 * params.num_turns + 1, 2 * reach + 1, 2 * reach + 1))
    cells = np.empty(num_points, dtype=np.int32)
    # The two cells that a maximum covers lie around a point if it is moved back by half a cell.
    x, y = (pose[0] - pyramid.x) / resolution - 0.5, (pose[1] - pyramid.y) / resolution - 0.5
    for turn in range(scores.shape[0]):
        theta = pose[2] + (turn - params.num_turns) * params.turn_step
        c, s = math.cos(theta) / resolution, math.sin(theta) / resolution
        count = 0
        for k in range(0, points.shape[0], params.point_step):
            u, v = float(points[k, 0]), float(points[k, 1])
            col, row = math.floor(x + c * u - s * v), math.floor(y + s * u + c * v)
            if 0 <= col < width and reach * stride <= row < height - reach * stride:
                cells[count] = row * width + col
                count += 1
        for i in range(2 * reach + 1):
            for j in range(2 * reach + 1):
                offset, total = ((i - reach) * width + j - reach) * stride, 0
                for k in range(count):
                    total += load(level, np.uint64(cells[k] + offset))
                scores[turn, i, j] = total / (FULL * max(num_points, 1))
    return scores


@njit(cache=True, error_model="numpy")
def second_moments(scores, params, step):
    """Return the second moments about the match of the likelihood that scores stand for: shape (3, 3), float64.

    `scores` is from `surface_scores`; `step` is the distance between positions [m].
    """
    best = scores.max()
    moments, total, d = np.zeros((3, 3)), 0.0, np.empty(3)
    for turn in range(scores.shape[0]):
        d[2] = (turn - scores.shape[0] // 2) * params.turn_step
        for i in range(scores.shape[1]):
            d[1] = (i - scores.shape[1] // 2) * step
            for j in range(scores.shape[2]):
                d[0] = (j - scores.shape[2] // 2) * step
                weight = math.exp((scores[turn, i, j] - best) / params.temperature)
                total += weight
                for r in range(3):
                    for q in range(r + 1):
                        moments[r, q] += weight * d[r] * d[q]
    for r in range(3):
        for q in range(r + 1):
            moments[r, q] = moments[q, r] = moments[r, q] / total
    return moments


@njit(cache=True, error_model="numpy")
def match_covariance(pyramid, points, pose, params):
    """Return the covariance of a match: shape (3, 3), float64, in the submap's frame [m^2, rad^2].

    From the second moments the part that comes of the steps is subtracted, down to 0. What the edge of the surface adds
    to the information is taken off, P <- (P^-1 - U^-1)^-1 with the moments U of a flat surface: one that is flat, as
    along a corridor, says nothing. Otherwise many such matches together would hold a robot where none of them can. The
    least variance of a match is added. For the arguments and errors see `surface_scores`.
    """
    step = max(round(params.step / pyramid.resolution), 1) * pyramid.resolution
    scores = surface_scores(pyramid, points, pose, params)
    moments = second_moments(scores, params, step)
    flat = np.empty(3)
    for r in range(3):
        reach, width = (scores.shape[1] // 2, step) if r < 2 else (scores.shape[0] // 2, params.turn_step)
        flat[r] = width * math.sqrt(max(reach * (reach + 1), 1) / 3.0)
        moments[r, r] -= params.grid_sigma_theta**2 if r == 2 else params.grid_sigma_xy**2
    for r in range(3):
        for q in range(3):
            moments[r, q] /= flat[r] * flat[q]
    values, vectors = np.linalg.eigh(moments)
    covariance = np.zeros((3, 3))
    for k in range(3):
        share = min(max(values[k], 0.0), MAX_SHARE)
        for r in range(3):
            for q in range(3):
                covariance[r, q] += share / (1.0 - share) * flat[r] * flat[q] * vectors[r, k] * vectors[q, k]
    for r in range(3):
        covariance[r, r] += params.least_sigma_theta**2 if r == 2 else params.least_sigma_xy**2
    return covariance
