import numpy as np
import pytest
from scipy import stats

from benchmarks.arena.statistics import (
    curve_band,
    estimate,
    interquartile_mean,
    paired_difference,
    probability_of_improvement,
    success_rate,
)


def test_interquartile_mean_is_the_mean_of_the_middle_half():
    assert interquartile_mean(np.array([6.0, 1.0, 4.0, 1000.0, 3.0, -50.0, 5.0, 2.0])) == pytest.approx(3.5)


def test_estimate_agrees_with_scipys_bootstrap():
    rng = np.random.default_rng(3)
    strata = [rng.exponential(2.0, 12), rng.normal(5.0, 1.0, 20)]
    expected = stats.bootstrap(
        strata,
        lambda *groups, axis: stats.trim_mean(np.concatenate(groups, axis=axis), 0.25, axis=axis),
        method="percentile",
        rng=np.random.default_rng(1),
    ).confidence_interval
    found = estimate(strata)
    assert found.iqm == stats.trim_mean(np.concatenate(strata), 0.25)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=0.08)
    assert found.n == 32


def test_worlds_are_strata():
    # Resampling across worlds would change their shares, and with them the estimate.
    assert estimate([np.zeros(10), np.ones(10)])[:3] == (0.5, 0.5, 0.5)


def test_interval_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(0)
    found = [estimate([rng.normal(1.0, 1.0, 30)]) for _ in range(200)]
    covered = np.mean([e.low <= 1.0 <= e.high for e in found])
    assert 0.88 <= covered <= 0.99


def test_one_episode_has_an_interval_of_no_width_and_none_has_no_estimate():
    assert estimate([np.array([0.7])]) == (0.7, 0.7, 0.7, 1)
    with pytest.raises(ValueError, match="at least one episode"):
        estimate([np.array([0.7]), np.array([])])


def test_success_rate_is_a_share_with_a_wilson_interval():
    assert success_rate([np.ones(10)]) == pytest.approx((1.0, 1.0 / (1.0 + 3.8415 / 10), 1.0, 10), abs=1e-4)
    assert success_rate([np.array([1, 1, 1, 0]), np.array([1, 1, 1, 1])]).iqm == 7 / 8


def test_pairs_cancel_what_they_share():
    hardness = np.random.default_rng(0).normal(100.0, 30.0, 12)
    assert paired_difference([hardness - 2.0], [hardness])[:3] == pytest.approx((-2.0, -2.0, -2.0))
    assert probability_of_improvement([hardness - 2.0], [hardness], higher_is_better=False)[:3] == (1.0, 1.0, 1.0)


def test_probability_of_improvement_counts_ties_half():
    a, b = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.0, 2.0, 5.0, 3.0])
    assert probability_of_improvement([a], [b], higher_is_better=True).iqm == 2.5 / 4
    assert probability_of_improvement([a], [b], higher_is_better=False).iqm == 1.5 / 4


def test_curve_band_is_the_interval_of_every_point():
    curves = np.random.default_rng(0).uniform(size=(9, 4)).cumsum(axis=1)
    middle, low, high = curve_band(curves, num_resamples=4000)
    for k in range(4):
        expected = estimate([curves[:, k]])
        assert (middle[k], low[k], high[k]) == pytest.approx(expected[:3], abs=0.08)
