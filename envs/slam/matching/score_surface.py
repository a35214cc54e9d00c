"""Covariance of a scan match from the scores of nearby poses (Olson, 2009, section III.C).

Scores around the optimum serve as log-likelihood, and its second moments as covariance. A match that can slide, as
along
a corridor, gets a long ellipse, which the curvature at the optimum would not show.
"""

from functools import cache

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import Pose2D

from .branch_and_bound import SearchWindow, discretise, total_at
from .fields import FULL_PERCENT, Pyramid

MAX_SURFACE, STEP = 1.0, 0.1
"""Maximum offset and step of scored positions along x and y [m]."""
NUM_TURNS, TURN_STEP = 2, 0.02
"""Number of scored headings on each side of the match, and step between headings [rad]."""
POINT_STEP = 4
"""Stride of the points that are scored."""
TEMPERATURE = 0.03
"""Score difference that changes the likelihood by a factor of e."""
STEP_STDS = np.array([0.06, 0.06, 0.015])
"""Standard deviations caused by the step size [m, m, rad], subtracted as variances."""
LEAST_STDS = np.array([0.03, 0.03, 0.008])
"""Standard deviations of a match that cannot slide [m, m, rad], added as variances."""
MAX_SHARE = 0.99
"""Maximum variance, as a fraction of the variance of a flat score surface."""


@njit(cache=True, error_model="numpy")
def _totals(pyramid, grid, reach, stride):
    """Return the summed level-1 cells at shifted points, shape (headings, rows, columns)."""
    level, width = pyramid.levels[1].ravel(), pyramid.levels.shape[2]
    totals = np.empty((grid.counts.shape[0], 2 * reach + 1, 2 * reach + 1), dtype=np.int64)
    for turn in range(totals.shape[0]):
        for i in range(2 * reach + 1):
            for j in range(2 * reach + 1):
                totals[turn, i, j] = total_at(level, grid, turn, ((i - reach) * width + j - reach) * stride)
    return totals


def surface_scores(pyramid: Pyramid, points: np.ndarray, pose: Pose2D, half_width: float) -> np.ndarray:
    """Score the poses around a match.

    Level 1 of the pyramid (maxima of 2 x 2 cells) is used, because walls one cell thick could fall between positions.

    Args:
        pyramid: maxima of the field.
        points: shape (n, 2), float32, base frame [m].
        pose: matched pose, frame of the field.
        half_width: maximum offset from the match [m].

    Returns:
        Scores from 0 to 1, shape (num_headings, num_rows, num_columns), float64, with the match in the middle.

    Raises:
        ValueError: if the offsets exceed the reach of the pyramid.
    """
    stride = max(round(STEP / pyramid.resolution), 1)
    reach = round(half_width / (stride * pyramid.resolution))
    window = SearchWindow(reach * stride * pyramid.resolution, NUM_TURNS * TURN_STEP, TURN_STEP)
    chosen = np.ascontiguousarray(points[::POINT_STEP])
    # The shift of half a cell centres the 2 x 2 cells of a maximum on the point.
    grid = discretise(pyramid, chosen, tuple(pose), window, 0.5)
    scores: np.ndarray = _totals(pyramid, grid, reach, stride) / (FULL_PERCENT * max(len(chosen), 1))
    return scores


@cache
def _offsets(shape: tuple[int, ...], step: float, turn_step: float) -> np.ndarray:
    """Return x, y and heading offsets of scores from the middle score, shape (3, num_scores), float64."""
    steps = np.array([[turn_step], [step], [step]])
    offsets: np.ndarray = (np.indices(shape).reshape(3, -1) - np.array(shape)[:, None] // 2) * steps
    return np.ascontiguousarray(offsets[::-1])


def second_moments(scores: np.ndarray, step: float, turn_step: float = TURN_STEP) -> np.ndarray:
    """Return the second moments about the match, shape (3, 3), of scores at intervals of `step` [m]."""
    weights = np.exp((scores.ravel() - scores.max()) / TEMPERATURE)
    d = _offsets(scores.shape, step, turn_step)
    moments: np.ndarray = (d * weights) @ d.T / weights.sum()
    return moments


def match_covariance(pyramid: Pyramid, points: np.ndarray, pose: Pose2D, half_width: float) -> np.ndarray:
    """Return the covariance of a match, shape (3, 3), float64, frame of the field [m^2, rad^2].

    The second moments are corrected for the step size and for the finite window: P <- (P^-1 - U^-1)^-1, with the
    moments
    U of a flat surface. Otherwise many uninformative matches, as along a corridor, would add up to a false position.
    `LEAST_STDS` is added. For arguments and errors see `surface_scores`.
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
