"""Covariance of a match from the scores around it.

Olson, Real-time correlative scan matching, 2009, section III.C: scores at poses around the optimum are taken for the
logarithm of a likelihood, and its second moments are the covariance. A match that can slide, as along a corridor,
scores alike wherever it slides to, and gets a long ellipse; the curvature at the optimum alone would not show that.
"""

from functools import cache

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import Pose2D

from .branch_and_bound import SearchWindow, discretise, total_at
from .fields import FULL_PERCENT, Pyramid

MAX_SURFACE, STEP = 1.0, 0.1
"""Largest offset along x and along y, and distance between positions, at best twice the side of a cell [m]."""
NUM_TURNS, TURN_STEP = 2, 0.02
"""Headings on each side of the match, and distance between them [rad]."""
POINT_STEP = 4
"""Every so many points are scored."""
TEMPERATURE = 0.03
"""Difference of scores that makes a pose less likely by a factor of e."""
STEP_STDS = np.array([0.06, 0.06, 0.015])
"""Standard deviations that come of the steps alone [m, m, rad]; they are subtracted."""
LEAST_STDS = np.array([0.03, 0.03, 0.008])
"""Standard deviations of a match that cannot slide [m, m, rad]; they are added."""
MAX_SHARE = 0.99
"""Variances above this share of a flat surface's are taken for it."""


@njit(cache=True, error_model="numpy")
def _totals(pyramid, grid, reach, stride):
    """Return sums of cells of level 1, points moved by up to `reach` strides: shape (headings, rows, columns)."""
    level, width = pyramid.levels[1].ravel(), pyramid.levels.shape[2]
    totals = np.empty((grid.counts.shape[0], 2 * reach + 1, 2 * reach + 1), dtype=np.int64)
    for turn in range(totals.shape[0]):
        for i in range(2 * reach + 1):
            for j in range(2 * reach + 1):
                totals[turn, i, j] = total_at(level, grid, turn, ((i - reach) * width + j - reach) * stride)
    return totals


def surface_scores(pyramid: Pyramid, points: np.ndarray, pose: Pose2D, half_width: float) -> np.ndarray:
    """Score the poses around a match.

    Scores are taken from level 1 of the pyramid, the maxima of 2 x 2 cells: walls one cell thick would fall between
    positions two cells apart. Points have shape (n, 2), float32, base frame [m]; the pose lies in the frame of the
    field. Returns shape (num_headings, num_rows, num_columns), float64, from 0 to 1, the match in the middle and the
    others up to `half_width` from it [m].

    Raises:
        ValueError: the offsets are larger than the pyramid was built for.
    """
    stride = max(round(STEP / pyramid.resolution), 1)
    reach = round(half_width / (stride * pyramid.resolution))
    window = SearchWindow(reach * stride * pyramid.resolution, NUM_TURNS * TURN_STEP, TURN_STEP)
    chosen = np.ascontiguousarray(points[::POINT_STEP])
    # The two cells that a maximum covers lie around a point if it is moved back by half a cell.
    grid = discretise(pyramid, chosen, tuple(pose), window, 0.5)
    scores: np.ndarray = _totals(pyramid, grid, reach, stride) / (FULL_PERCENT * max(len(chosen), 1))
    return scores


@cache
def _offsets(shape: tuple[int, ...], step: float, turn_step: float) -> np.ndarray:
    """Return x, y and turn of scores of a shape from the one in the middle: shape (3, number of scores), float64."""
    steps = np.array([[turn_step], [step], [step]])
    offsets: np.ndarray = (np.indices(shape).reshape(3, -1) - np.array(shape)[:, None] // 2) * steps
    return np.ascontiguousarray(offsets[::-1])


def second_moments(scores: np.ndarray, step: float, turn_step: float = TURN_STEP) -> np.ndarray:
    """Return the second moments about the match, shape (3, 3), of the likelihood that scores `step` [m] apart mean."""
    weights = np.exp((scores.ravel() - scores.max()) / TEMPERATURE)
    d = _offsets(scores.shape, step, turn_step)
    moments: np.ndarray = (d * weights) @ d.T / weights.sum()
    return moments


def match_covariance(pyramid: Pyramid, points: np.ndarray, pose: Pose2D, half_width: float) -> np.ndarray:
    """Return the covariance of a match: shape (3, 3), float64, in the frame of the field [m^2, rad^2].

    From the second moments the part that comes of the steps is subtracted, down to 0. What the edge of the surface adds
    to the information is taken off, P <- (P^-1 - U^-1)^-1 with the moments U of a flat surface: one that is flat, as
    along a corridor, says nothing. Otherwise many such matches together would hold a robot where none of them can. The
    least variance of a match is added. For the arguments and errors see `surface_scores`.
    """
    step = max(round(STEP / pyramid.resolution), 1) * pyramid.resolution
    scores = surface_scores(pyramid, points, pose, half_width)
    reach = np.array([scores.shape[1] // 2, scores.shape[1] // 2, scores.shape[0] // 2])
    flat = np.array([step, step, TURN_STEP]) * np.sqrt(np.maximum(reach * (reach + 1), 1) / 3.0)
    moments = second_moments(scores, step) - np.diag(STEP_STDS**2)
    values, vectors = np.linalg.eigh(moments / np.outer(flat, flat))
    share = np.clip(values, 0.0, MAX_SHARE)
    covariance = vectors * (share / (1.0 - share)) @ vectors.T * np.outer(flat, flat)
    return 0.5 * (covariance + covariance.T) + np.diag(LEAST_STDS**2)
