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

CONFIDENCE = 0.95
TAILS = ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2)
"""Quantiles of the resamples at which the intervals end."""
NUM_RESAMPLES = 2000
"""Bootstrap resamples of an interval."""
NUM_CURVE_RESAMPLES = 500
"""Bootstrap resamples of a band around a curve."""


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
    is_bound: tuple[bool, bool, bool] = (False, False, False)
    """Whether such episodes decide the estimate, and the ends of the interval, which are then lower bounds."""


class Band(NamedTuple):
    """A curve and the ends of its 95 % intervals, shape (points,) each."""

    middle: np.ndarray
    low: np.ndarray
    high: np.ndarray


def interquartile_mean(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Return the mean of the middle half: what is left without the lowest and the highest quarter."""
    return stats.trim_mean(values, 0.25, axis=axis)


def estimate(strata: Sequence[np.ndarray], reached: Sequence[np.ndarray] | None = None) -> Estimate:
    """Return the interquartile mean over all strata, with its stratified bootstrap interval.

    One episode alone gives an interval of no width: it says nothing about the spread, and `n` tells. Where `reached`
    (shapes as `strata`, bool) is False, the value is only a lower bound; None where there are no such.
    """
    found = _bootstrap(strata, interquartile_mean)
    if reached is None or all(stratum.all() for stratum in reached):
        return found
    unlimited = [np.where(known, values, np.inf) for values, known in zip(strata, reached, strict=True)]
    with np.errstate(invalid="ignore"):
        is_bound = [not np.isfinite(number) for number in _bootstrap(unlimited, interquartile_mean)[:3]]
    never = sum(int(np.count_nonzero(~stratum)) for stratum in reached)
    return found._replace(never=never, is_bound=(is_bound[0], is_bound[1], is_bound[2]))


def success_rate(strata: Sequence[np.ndarray]) -> Estimate:
    """Return the share of successes with its Wilson score interval.

    A share is a mean: the interquartile mean of zeros and ones would round it. Of ten successes in ten the bootstrap
    would conclude that failure is impossible; the score interval does not. `strata` holds 0 or 1.
    """
    outcomes = np.concatenate(strata)
    test = stats.binomtest(int(outcomes.sum()), len(outcomes))
    interval = test.proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(float(outcomes.mean()), float(interval.low), float(interval.high), len(outcomes))


def paired_difference(a: Sequence[np.ndarray], b: Sequence[np.ndarray]) -> Estimate:
    """Return the interquartile mean of the differences a - b, pair by pair, with its stratified bootstrap interval.

    Pairs share world and seed, so what makes one start harder than another cancels out.
    """
    return _bootstrap([x - y for x, y in zip(a, b, strict=True)], interquartile_mean)


def paired_ratio(a: Sequence[np.ndarray], b: Sequence[np.ndarray]) -> Estimate:
    """Return the geometric mean of the ratios a / b, pair by pair, with its stratified bootstrap interval."""
    logs = _bootstrap([np.log(x / y) for x, y in zip(a, b, strict=True)], np.mean)
    return logs._replace(iqm=float(np.exp(logs.iqm)), low=float(np.exp(logs.low)), high=float(np.exp(logs.high)))


def probability_of_improvement(a: Sequence[np.ndarray], b: Sequence[np.ndarray], higher_is_better: bool) -> Estimate:
    """Return how probably a does better than b on the same world and seed, with its stratified bootstrap interval.

    The share of pairs that a wins; ties count half.
    """
    sign = 1.0 if higher_is_better else -1.0
    wins = [0.5 + 0.5 * np.sign(sign * (x - y)) for x, y in zip(a, b, strict=True)]
    return _bootstrap(wins, np.mean)


def gap_closed(gains: Sequence[np.ndarray], bounds: Sequence[np.ndarray]) -> Estimate:
    """Return which share of the gap from a reference to a bound a policy closes, with a stratified bootstrap interval.

    The interquartile mean of what the policy gains on the reference, over that of what the bound gains on it: 0 is the
    reference, 1 the bound. A ratio of means and not a mean of ratios: starts from which the bound gains next to nothing
    would decide the latter. Where the bound does not clearly gain (the lower end of its interval is not positive),
    there is no gap to close: NaN.
    """
    gap = _bootstrap(bounds, interquartile_mean)
    if gap.low <= 0.0:
        return Estimate(np.nan, np.nan, np.nan, gap.n)
    own, whole = np.concatenate(gains), np.concatenate(bounds)
    draws = _draws([len(values) for values in gains], NUM_RESAMPLES)
    ratios = interquartile_mean(own[draws]) / interquartile_mean(whole[draws])
    low, high = np.quantile(ratios, TAILS)
    return Estimate(float(interquartile_mean(own) / interquartile_mean(whole)), float(low), float(high), gap.n)


def performance_profile(strata: Sequence[np.ndarray], thresholds: np.ndarray) -> Band:
    """Return the share of episodes whose score is above each threshold, with its stratified bootstrap interval."""
    above = [(np.asarray(values)[:, None] > thresholds).astype(np.float64) for values in strata]
    return _band(above, np.mean)


def curve_band(strata: Sequence[np.ndarray]) -> Band:
    """Return the interquartile mean of curves, shape (episodes, points) per world, with its interval at each point."""
    return _band(strata, interquartile_mean)


def _band(strata: Sequence[np.ndarray], statistic: Callable[..., np.ndarray]) -> Band:
    """Return a statistic of curves, point by point; the same resamples at every point, so that the band is smooth."""
    curves = np.concatenate(strata)
    draws = _draws([len(values) for values in strata], NUM_CURVE_RESAMPLES)
    # In parts, because all resamples of all points at once would fill the memory of a small machine.
    parts = np.array_split(curves, max(1, NUM_CURVE_RESAMPLES * curves.size // 2_000_000), axis=1)
    ends = [np.quantile(statistic(part[draws], axis=1), TAILS, axis=0) for part in parts]
    low, high = np.concatenate(ends, axis=1)
    return Band(statistic(curves, axis=0), low, high)


def _bootstrap(strata: Sequence[np.ndarray], statistic: Callable[..., np.ndarray]) -> Estimate:
    """Return a statistic of all values together with the percentile interval over stratified resamples."""
    if not strata or any(len(values) == 0 for values in strata):
        raise ValueError("an estimate needs at least one episode in every world")
    together = np.concatenate([np.asarray(values, dtype=np.float64) for values in strata])
    draws = together[_draws([len(values) for values in strata], NUM_RESAMPLES)]
    low, high = np.quantile(statistic(draws, axis=-1), TAILS)
    return Estimate(float(statistic(together, axis=-1)), float(low), float(high), len(together))


def _draws(sizes: Sequence[int], num_resamples: int) -> np.ndarray:
    """Return the episodes of every resample, drawn from each stratum by itself: shape (num_resamples, episodes)."""
    # A generator of its own: the same episodes always give the same summary.
    rng = np.random.default_rng(0)
    firsts = np.cumsum([0, *sizes[:-1]])
    return np.concatenate(
        [first + rng.integers(size, size=(num_resamples, size)) for first, size in zip(firsts, sizes, strict=True)],
        axis=1,
    )
