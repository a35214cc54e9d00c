"""Covariance of a scan match from scores of nearby poses (Olson, 2009, section III.C).

Scores are log-likelihoods of poses; the covariance is the second moment of this distribution. A match that can slide
along a corridor gets a long ellipse, which the curvature at the optimum would not show.
"""

from functools import cache

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D

from .branch_and_bound import SearchWindow, discretise, total_at
from .fields import FULL_PERCENT, Pyramid

MAX_SURFACE, STEP = 1.0, 0.1
"""Scored positions around a scan match: maximum offset along x and y, and spacing [m]."""
NUM_TURNS, TURN_STEP = 2, 0.02
"""Number of scored headings on each side of the matched heading, and angle between them [rad]."""
POINT_STEP = 4
TEMPERATURE = 0.03
"""Score difference that multiplies the likelihood of a pose by e."""
STEP_STDS = np.array([0.06, 0.06, 0.015])
"""Standard deviations due to the spacing of scored poses [m, m, rad]; their squares are subtracted from match
covariances."""
LEAST_STDS = np.array([0.03, 0.03, 0.008])
"""Minimum standard deviations of a scan match [m, m, rad]; their squares are added to its covariance."""
MAX_SHARE = 0.99


@njit(cache=True, error_model="numpy")
def _totals(pyramid, grid, reach, stride):
    level, width = pyramid.levels[1].ravel(), pyramid.levels.shape[2]
    totals = np.empty((grid.counts.shape[0], 2 * reach + 1, 2 * reach + 1), dtype=np.int64)
    for turn in range(totals.shape[0]):
        for i in range(2 * reach + 1):
            for j in range(2 * reach + 1):
                totals[turn, i, j] = total_at(level, grid, turn, ((i - reach) * width + j - reach) * stride)
    return totals


def surface_scores(pyramid: Pyramid, points: np.ndarray, pose: Pose2D, half_width: float) -> np.ndarray:
    """Return scores of poses around a scan match: mean occupancies at the scan points, from 0 to 1.

    Shape (num_headings, num_rows, num_columns), float64. Maxima over 2 x 2 cells are used, because spaced positions
    could skip thin walls. `points`: shape (n, 2), float32, base frame [m]. `pose`: frame of the grid. `half_width`:
    maximum offset [m], at most the reach of the pyramid.
    """
    stride = max(round(STEP / pyramid.resolution), 1)
    reach = round(half_width / (stride * pyramid.resolution))
    window = SearchWindow(reach * stride * pyramid.resolution, NUM_TURNS * TURN_STEP, TURN_STEP)
    chosen = np.ascontiguousarray(points[::POINT_STEP])
    # Half a cell of shift centres the 2 x 2 cells of a maximum on the point.
    grid = discretise(pyramid, chosen, tuple(pose), window, 0.5)
    scores: np.ndarray = _totals(pyramid, grid, reach, stride) / (FULL_PERCENT * max(len(chosen), 1))
    return scores


@cache
def _offsets(shape: tuple[int, ...], step: float) -> np.ndarray:
    steps = np.array([[TURN_STEP], [step], [step]])
    offsets: np.ndarray = (np.indices(shape).reshape(3, -1) - np.array(shape)[:, None] // 2) * steps
    return np.ascontiguousarray(offsets[::-1])


def second_moments(scores: np.ndarray, step: float) -> np.ndarray:
    """Return second moments of the pose about a match, shape (3, 3), from scores of nearby poses.

    `step`: distance between scored poses [m].
    """
    weights = np.exp((scores.ravel() - scores.max()) / TEMPERATURE)
    d = _offsets(scores.shape, step)
    moments: np.ndarray = (d * weights) @ d.T / weights.sum()
    return moments


def match_covariance(pyramid: Pyramid, points: np.ndarray, pose: Pose2D, half_width: float) -> np.ndarray:
    """Return the covariance of a scan match, shape (3, 3), float64, frame of the grid [m^2, rad^2].

    It is large if nearby poses score similarly, and corrected for the limited search area. Arguments as in
    `surface_scores`.
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
