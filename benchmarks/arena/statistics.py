"""Estimates with intervals from few episodes.

Interquartile means, stratified bootstrap intervals and the probability of improvement follow Agarwal et al., "Deep
Reinforcement Learning at the Edge of the Statistical Precipice" (2021). Worlds are the strata: every resample keeps the
number of episodes of each world. SciPy's `bootstrap` draws the same resamples, but refuses a stratum of one episode and
knows no pairs; a test holds this module against it.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
"""Coverage of the intervals."""
NUM_RESAMPLES = 2000
"""Bootstrap resamples of an interval."""


class Estimate(NamedTuple):
    """A number and how sure it is."""

    iqm: float
    """The estimate: an interquartile mean, or what the function that returns it says."""
    low: float
    """Lower end of the 95 % interval."""
    high: float
    """Upper end of the 95 % interval."""
    n: int
    """Episodes that went in."""


def interquartile_mean(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Return the mean of the middle half: what is left without the lowest and the highest quarter."""
    return stats.trim_mean(values, 0.25, axis=axis)


def estimate(strata: Sequence[np.ndarray]) -> Estimate:
    """Return the interquartile mean over all strata, with its stratified bootstrap interval.

    Args:
        strata: per world the values of its episodes, shape (episodes,). One episode alone gives an interval of no
            width: it says nothing about the spread, and `n` tells.
    """
    return _bootstrap(strata, interquartile_mean)


def success_rate(strata: Sequence[np.ndarray]) -> Estimate:
    """Return the share of successes with its Wilson score interval.

    A share is a mean: the interquartile mean of zeros and ones would round it. Of ten successes in ten the bootstrap
    would conclude that failure is impossible; the score interval does not.

    Args:
        strata: per world the outcomes of its episodes, shape (episodes,), 0 or 1.
    """
    outcomes = np.concatenate(strata)
    test = stats.binomtest(int(outcomes.sum()), len(outcomes))
    interval = test.proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(float(outcomes.mean()), float(interval.low), float(interval.high), len(outcomes))


def paired_difference(a: Sequence[np.ndarray], b: Sequence[np.ndarray]) -> Estimate:
    """Return the interquartile mean of the differences a - b, pair by pair, with its stratified bootstrap interval.

    Pairs share world and seed, so what makes one start harder than another cancels out.

    Args:
        a: per world the values of its episodes, shape (episodes,).
        b: the same of the other policy, in the same order.
    """
    return _bootstrap([x - y for x, y in zip(a, b, strict=True)], interquartile_mean)


def probability_of_improvement(a: Sequence[np.ndarray], b: Sequence[np.ndarray], higher_is_better: bool) -> Estimate:
    """Return how probably a does better than b on the same world and seed, with its stratified bootstrap interval.

    The share of pairs that a wins; ties count half.

    Args:
        a: per world the values of its episodes, shape (episodes,).
        b: the same of the other policy, in the same order.
        higher_is_better: which way is up.
    """
    sign = 1.0 if higher_is_better else -1.0
    wins = [0.5 + 0.5 * np.sign(sign * (x - y)) for x, y in zip(a, b, strict=True)]
    return _bootstrap(wins, np.mean)


def curve_band(curves: np.ndarray, num_resamples: int = 500) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the interquartile mean of curves and the lower and upper end of its bootstrap interval, point by point.

    Args:
        curves: shape (episodes, points).
        num_resamples: bootstrap resamples; the same ones at every point, so that the band is smooth.

    Returns:
        Three arrays of shape (points,).
    """
    draws = np.random.default_rng(0).integers(len(curves), size=(num_resamples, len(curves)))
    tails = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
    # In parts, because all resamples of all points at once would fill the memory of a small machine.
    parts = np.array_split(curves, max(1, num_resamples * curves.size // 2_000_000), axis=1)
    ends = [np.quantile(interquartile_mean(part[draws], axis=1), tails, axis=0) for part in parts]
    low, high = np.concatenate(ends, axis=1)
    return interquartile_mean(curves, axis=0), low, high


def _bootstrap(strata: Sequence[np.ndarray], statistic: Callable[..., np.ndarray]) -> Estimate:
    """Return a statistic of all values together with the percentile interval over stratified resamples."""
    if not strata or any(len(values) == 0 for values in strata):
        raise ValueError("an estimate needs at least one episode in every world")
    # A generator of its own: the same episodes always give the same summary.
    rng = np.random.default_rng(0)
    values = [np.asarray(stratum, dtype=np.float64) for stratum in strata]
    draws = np.concatenate([v[rng.integers(len(v), size=(NUM_RESAMPLES, len(v)))] for v in values], axis=1)
    low, high = np.quantile(statistic(draws, axis=-1), [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    together = np.concatenate(values)
    return Estimate(float(statistic(together, axis=-1)), float(low), float(high), len(together))
