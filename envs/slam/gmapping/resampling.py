"""Importance weights, effective sample size and resampling."""

import math

import numpy as np


def normalized_weights(log_weights: np.ndarray) -> np.ndarray:
    """Return weights that add up to 1, shape (n,), float64, from their logarithms up to a common summand."""
    weights: np.ndarray = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


def effective_sample_size(weights: np.ndarray) -> float:
    """Return 1 / sum w^2 of normalized weights (Grisetti et al., 2007, equation 20): from 1 to their number."""
    return 1.0 / float(np.square(weights).sum())


def systematic_resample(weights: np.ndarray, offset: float) -> np.ndarray:
    """Choose particles by systematic resampling (Kitagawa, Monte Carlo filter and smoother, 1996).

    Args:
        weights: shape (n,), float64, normalized.
        offset: uniform, from 0 to 1, 1 excluded: the one random number.

    Returns:
        Shape (n,), int64, ascending: particle i is chosen n w_i times, rounded down or up.
    """
    n = len(weights)
    return np.minimum(np.searchsorted(np.cumsum(weights), (np.arange(n) + offset) / n, side="right"), n - 1)


def spread(poses: np.ndarray, weights: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Return the covariance of weighted poses, shape (n, 3), about their mean: shape (3, 3), float64 [m, rad].

    Headings are taken as turns from that of the pose `around`, so that the wrap at half a turn does no harm.
    """
    apart = poses - around
    apart[:, 2] = (apart[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    apart -= weights @ apart
    covariance: np.ndarray = (apart * weights[:, None]).T @ apart
    return 0.5 * (covariance + covariance.T)
