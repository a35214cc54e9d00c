"""Importance weights, effective sample size and resampling."""

import math

import numpy as np
from numba import njit


def normalized_weights(log_weights: np.ndarray) -> np.ndarray:
    """Return weights that add up to 1, shape (n,), float64, from their logarithms up to a common summand."""
    weights: np.ndarray = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


def effective_sample_size(weights: np.ndarray) -> float:
    """Return 1 / sum w^2 of normalized weights (Grisetti et al., 2007, equation 20): from 1 to their number."""
    return 1.0 / float(np.square(weights).sum())


@njit(cache=True, error_model="numpy")
def systematic_resample(weights, offset):
    """Choose particles by systematic resampling (Kitagawa, Monte Carlo filter and smoother, 1996).

    Args:
        weights: shape (n,), float64, normalized.
        offset: uniform, from 0 to 1, 1 excluded: the one random number.

    Returns:
        Shape (n,), int64, ascending: particle i is chosen n w_i times, rounded down or up.
    """
    n = weights.shape[0]
    chosen = np.empty(n, dtype=np.int64)
    i, total = 0, weights[0]
    for k in range(n):
        while (k + offset) / n >= total and i < n - 1:
            i += 1
            total += weights[i]
        chosen[k] = i
    return chosen


def spread(poses: np.ndarray, weights: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Return the covariance of weighted poses, shape (n, 3), about their mean: shape (3, 3), float64 [m, rad].

    Headings are taken as turns from that of the pose `around`, so that the wrap at half a turn does no harm.
    """
    apart = poses - around
    apart[:, 2] = (apart[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    apart -= weights @ apart
    covariance: np.ndarray = (apart * weights[:, None]).T @ apart
    return 0.5 * (covariance + covariance.T)
