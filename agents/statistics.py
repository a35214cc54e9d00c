"""Estimates with confidence intervals from few episodes, by a bootstrap stratified by world.

Source: Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice" (2021). `Strata` holds
one array of shape (episodes,) per world. SciPy's `bootstrap` rejects strata of one episode, and the import of
`scipy.stats` takes most of a second.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

Strata = Sequence[np.ndarray]
TAILS = (0.025, 0.975)
NUM_RESAMPLES, NUM_CURVE_RESAMPLES = 2000, 500
"""Numbers of bootstrap resamples for scalars and curves."""


class Estimate(NamedTuple):
    """Estimate of a statistic with its 95 % interval."""

    iqm: float
    """Point estimate, by default an interquartile mean."""
    low: float
    high: float
    n: int
    never: int = 0
    """Number of episodes that never reached the threshold; their value is the time or distance limit."""
    is_bound: tuple[bool, ...] = (False, False, False)
    """Whether `iqm`, `low` and `high` are only lower bounds, because episodes did not reach the threshold."""


MIN_STRATUM = 5
"""Minimum number of episodes in a world that the bootstrap resamples apart from other worlds."""
Band = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Curve (shape (points,)) or scalar, with the lower and upper end of its 95 % interval."""


def interquartile_mean(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Return the mean of the middle half of the values."""
    values = np.moveaxis(values, axis, -1)
    start = values.shape[-1] // 4
    stop = values.shape[-1] - start
    return np.partition(values, (start, stop - 1), axis=-1)[..., start:stop].mean(axis=-1)


def bootstrap(strata: Strata, statistic: Callable[..., np.ndarray], num_resamples: int = NUM_RESAMPLES) -> Band:
    """Return a statistic with its 95 % percentile interval from the bootstrap.

    `strata`, one array per world, have shape (episodes,) or (episodes, points). Each is resampled separately; those of
    fewer than `MIN_STRATUM` episodes, whose intervals would be too narrow, together.

    Raises:
        ValueError: if a stratum is empty.
    """
    if not strata or any(len(values) == 0 for values in strata):
        raise ValueError("an estimate needs at least one episode in every world")
    small = [values for values in strata if len(values) < MIN_STRATUM]
    strata = [values for values in strata if len(values) >= MIN_STRATUM] + ([np.concatenate(small)] if small else [])
    together = np.concatenate(strata).astype(np.float64)
    rng, first, draws = np.random.default_rng(0), 0, list[np.ndarray]()
    for size in map(len, strata):
        draws.append(first + rng.integers(size, size=(num_resamples, size)))
        first += size
    indices = np.concatenate(draws, axis=1)
    points = together.reshape(len(together), -1)
    parts = np.array_split(points, max(1, num_resamples * points.size // 2_000_000), axis=1)
    ends = [np.quantile(statistic(part[indices], axis=1), TAILS, axis=0) for part in parts]
    low, high = np.concatenate(ends, axis=1).reshape(2, *together.shape[1:])
    return statistic(together, axis=0), low, high


def estimate(
    strata: Strata, reached: Strata | None = None, statistic: Callable[..., np.ndarray] = interquartile_mean
) -> Estimate:
    """Estimate a statistic of episode values with its 95 % bootstrap interval.

    `strata` has one array per world. `reached`, of equal shapes, is False for values that are only lower bounds.
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
    """Return the success rate (mean of outcomes 0 or 1) with its 95 % Wilson score interval."""
    outcomes = np.concatenate(strata)
    n, rate, z = len(outcomes), float(outcomes.mean()), float(ndtri(TAILS[1]))
    middle = (rate + z**2 / (2.0 * n)) / (1.0 + z**2 / n)
    half = z * math.sqrt(rate * (1.0 - rate) / n + (z / (2.0 * n)) ** 2) / (1.0 + z**2 / n)
    return Estimate(rate, max(0.0, middle - half), min(1.0, middle + half), n)


def score(scores: np.ndarray, *, is_widened: bool = False) -> Estimate:
    """Return the mean over episodes, then the interquartile mean over seeds, with its 95 % interval.

    `scores` has shape (seeds, episodes). The bootstrap resamples seeds and episodes independently. `is_widened`: if
    all scores are equal and lie in [0, 1], return Wilson's interval for a success rate of this value, not a width of 0.
    """
    rng, (num_seeds, num_episodes) = np.random.default_rng(0), scores.shape
    seeds = rng.integers(num_seeds, size=(NUM_RESAMPLES, num_seeds))
    episodes = rng.integers(num_episodes, size=(NUM_RESAMPLES, num_episodes))
    means = scores[:, episodes].mean(axis=2).T
    low, high = np.quantile(interquartile_mean(np.take_along_axis(means, seeds, axis=1)), TAILS)
    if is_widened and np.ptp(scores) == 0.0 and 0.0 <= scores[0, 0] <= 1.0:
        low, high = success_rate([np.arange(scores.size) < round(scores[0, 0] * scores.size)])[1:3]
    return Estimate(float(interquartile_mean(scores.mean(axis=1))), float(low), float(high), scores.size)


def paired_difference(a: Strata, b: Strata, statistic: Callable[..., np.ndarray] = interquartile_mean) -> Estimate:
    """Estimate a statistic, by default the interquartile mean, of the differences a - b of paired episodes."""
    return estimate([x - y for x, y in zip(a, b, strict=True)], statistic=statistic)


def paired_ratio(a: Strata, b: Strata) -> Estimate:
    """Return the geometric mean of the ratios a / b of paired episodes, with its 95 % interval."""
    logs = estimate([np.log(x / y) for x, y in zip(a, b, strict=True)], statistic=np.mean)
    middle, low, high = (float(np.exp(number)) for number in logs[:3])
    return Estimate(middle, low, high, logs.n)


def curve_band(strata: Strata) -> Band:
    """Return the average curve of all episodes (interquartile mean at each point) with 95 % bootstrap interval.

    `strata` has one array per world, shape (episodes, points).
    """
    return bootstrap(strata, interquartile_mean, NUM_CURVE_RESAMPLES)
