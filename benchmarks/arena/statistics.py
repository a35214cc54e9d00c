"""Estimates with intervals from few episodes.

Interquartile means, stratified bootstrap intervals, performance profiles and the probability of improvement follow
Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice" (2021). Worlds are the strata:
every resample keeps the number of episodes of each world. SciPy's `bootstrap` draws the same resamples, but refuses a
stratum of one episode and has no pairs; a test holds this module against it.

Values are given per world, an array of shape (episodes,) each; pairs as two such sequences in the same order.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

Strata = Sequence[np.ndarray]
TAILS = (0.025, 0.975)
"""Quantiles of the resamples at which the intervals end."""
NUM_RESAMPLES, NUM_CURVE_RESAMPLES = 2000, 500
"""Bootstrap resamples of an interval, and of a band around a curve."""


class Estimate(NamedTuple):
    """A number and its 95 % interval."""

    iqm: float
    """The estimate: an interquartile mean, or what the function that returns it says."""
    low: float
    high: float
    n: int
    """Episodes that went in."""
    never: int = 0
    """How many of them never reached the mark that is measured; they went in as their limits."""
    is_bound: tuple[bool, ...] = (False, False, False)
    """Whether such episodes decide the estimate, and the ends of the interval, which are then lower bounds."""


Band = tuple[np.ndarray, np.ndarray, np.ndarray]
"""A curve and the lower and upper ends of its 95 % intervals, shape (points,) each; of single values, three numbers."""


def interquartile_mean(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Return the mean of the middle half: what is left without the lowest and the highest quarter."""
    return stats.trim_mean(values, 0.25, axis=axis)


def bootstrap(strata: Strata, statistic: Callable[..., np.ndarray], num_resamples: int = NUM_RESAMPLES) -> Band:
    """Return a statistic of all values, and its percentile interval over stratified resamples.

    Strata have shape (episodes,), or (episodes, points) with the same resamples at every point.

    Raises:
        ValueError: if a stratum has no episode.
    """
    if not strata or any(len(values) == 0 for values in strata):
        raise ValueError("an estimate needs at least one episode in every world")
    together = np.concatenate(strata).astype(np.float64)
    draws = _draws(strata, num_resamples)
    # In parts, because all resamples of all points at once would fill the memory of a small machine.
    points = together.reshape(len(together), -1)
    parts = np.array_split(points, max(1, num_resamples * points.size // 2_000_000), axis=1)
    ends = [np.quantile(statistic(part[draws], axis=1), TAILS, axis=0) for part in parts]
    low, high = np.concatenate(ends, axis=1).reshape(2, *together.shape[1:])
    return statistic(together, axis=0), low, high


def _draws(strata: Strata, num_resamples: int) -> np.ndarray:
    """Return the episodes of every resample, drawn from each stratum by itself: shape (num_resamples, episodes)."""
    # A generator of its own: the same episodes always give the same summary.
    rng, first, draws = np.random.default_rng(0), 0, []
    for size in map(len, strata):
        draws.append(first + rng.integers(size, size=(num_resamples, size)))
        first += size
    return np.concatenate(draws, axis=1)


def estimate(
    strata: Strata, reached: Strata | None = None, statistic: Callable[..., np.ndarray] = interquartile_mean
) -> Estimate:
    """Return a statistic over all strata, with its stratified bootstrap interval.

    One episode alone gives an interval of no width: it says nothing about the spread, and `n` tells. Where `reached`
    (shapes as `strata`, bool) is False, the value is only a lower bound; None where there are no such.
    """
    middle, low, high = map(float, bootstrap(strata, statistic))
    found = Estimate(middle, low, high, sum(map(len, strata)))
    if reached is None or all(stratum.all() for stratum in reached):
        return found
    unlimited = [np.where(known, values, np.inf) for values, known in zip(strata, reached, strict=True)]
    with np.errstate(invalid="ignore"):
        is_bound = tuple(not np.isfinite(number) for number in bootstrap(unlimited, statistic))
    return found._replace(never=sum(int(np.sum(~stratum)) for stratum in reached), is_bound=is_bound)


def success_rate(strata: Strata) -> Estimate:
    """Return the share of successes (1, not 0) with its Wilson score interval.

    An interquartile mean would round it, and of ten successes in ten the bootstrap would conclude that none can fail.
    """
    outcomes = np.concatenate(strata)
    interval = stats.binomtest(int(outcomes.sum()), len(outcomes)).proportion_ci(method="wilson")
    return Estimate(float(outcomes.mean()), float(interval.low), float(interval.high), len(outcomes))


def paired_difference(a: Strata, b: Strata) -> Estimate:
    """Return the interquartile mean of a - b, pair by pair: what makes one start harder than another cancels out."""
    return estimate([x - y for x, y in zip(a, b, strict=True)])


def paired_ratio(a: Strata, b: Strata) -> Estimate:
    """Return the geometric mean of a / b, pair by pair."""
    logs = estimate([np.log(x / y) for x, y in zip(a, b, strict=True)], statistic=np.mean)
    middle, low, high = (float(np.exp(number)) for number in logs[:3])
    return Estimate(middle, low, high, logs.n)


def probability_of_improvement(a: Strata, b: Strata, higher_is_better: bool) -> Estimate:
    """Return the share of pairs that a wins, ties counting half."""
    sign = 1.0 if higher_is_better else -1.0
    return estimate([0.5 + 0.5 * np.sign(sign * (x - y)) for x, y in zip(a, b, strict=True)], statistic=np.mean)


def gap_closed(gains: Strata, bounds: Strata) -> Estimate:
    """Return what a policy gains on the reference over what the bound gains on it, both interquartile means.

    A ratio of means and not a mean of ratios, which starts would decide from which the bound gains next to nothing.
    Where the lower end of the bound's gain is not positive, there is no gap to close: NaN.
    """
    gap = estimate(bounds)
    if gap.low <= 0.0:
        return Estimate(np.nan, np.nan, np.nan, gap.n)
    own, whole = np.concatenate(gains), np.concatenate(bounds)
    draws = _draws(gains, NUM_RESAMPLES)
    low, high = np.quantile(interquartile_mean(own[draws]) / interquartile_mean(whole[draws]), TAILS)
    return Estimate(float(interquartile_mean(own) / interquartile_mean(whole)), float(low), float(high), gap.n)


def performance_profile(strata: Strata, thresholds: np.ndarray) -> Band:
    """Return the share of episodes whose score is above each threshold."""
    return bootstrap([np.asarray(values)[:, None] > thresholds for values in strata], np.mean, NUM_CURVE_RESAMPLES)


def curve_band(strata: Strata) -> Band:
    """Return the interquartile mean of curves, shape (episodes, points) per world."""
    return bootstrap(strata, interquartile_mean, NUM_CURVE_RESAMPLES)
