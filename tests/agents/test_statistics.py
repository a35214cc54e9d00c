import numpy as np
import pytest
from scipy import stats

from lidarnaut.agents.statistics import (
    curve_band,
    estimate,
    paired_difference,
    score,
    success_rate,
)


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
    # Resampling across worlds would change their shares and the estimate.
    assert estimate([np.zeros(10), np.ones(10)])[:3] == (0.5, 0.5, 0.5)


def test_one_episode_has_an_interval_of_no_width_and_none_has_no_estimate():
    assert estimate([np.array([0.7])])[:4] == (0.7, 0.7, 0.7, 1)
    with pytest.raises(ValueError, match="at least one episode"):
        estimate([np.array([0.7]), np.array([])])


def test_success_rate_is_a_share_with_a_wilson_interval():
    for successes in (0, 3, 10):
        rate, low, high, n, *_ = success_rate([np.arange(10) < successes])
        expected = stats.binomtest(successes, 10).proportion_ci(method="wilson")
        assert (rate, low, high, n) == pytest.approx((successes / 10, expected.low, expected.high, 10))
    assert success_rate([np.array([1, 1, 1, 0]), np.array([1, 1, 1, 1])]).iqm == 7 / 8


def test_pairs_cancel_what_they_share():
    hardness = np.random.default_rng(0).normal(100.0, 30.0, 12)
    assert paired_difference([hardness - 2.0], [hardness])[:3] == pytest.approx((-2.0, -2.0, -2.0))


def test_curve_band_is_the_interval_of_every_point():
    curves = np.random.default_rng(0).uniform(size=(9, 4)).cumsum(axis=1)
    middle, low, high = curve_band([curves[:4], curves[4:]])
    for k in range(4):
        expected = estimate([curves[:4, k], curves[4:, k]])
        assert (middle[k], low[k], high[k]) == pytest.approx(expected[:3], abs=0.12)


def test_lower_bounds_show_where_they_decide():
    values, reached = np.arange(8.0), np.arange(8) < 6
    exact = estimate([values])
    found = estimate([values], [reached])
    # The two infinite times are in the discarded quarter, but not in all resamples.
    assert found[:4] == exact[:4]
    assert (found.never, found.is_bound) == (2, (False, False, True))
    assert estimate([values], [reached & (values < 5)]).is_bound == (True, False, True)
    assert estimate([values], [values < 0]).is_bound == (True, True, True)
    assert estimate([values], [values >= 0]) == exact


def test_scores_have_the_width_of_what_differs_between_seeds_and_between_episodes():
    assert score(np.full((3, 5), 0.25))[:3] == (0.25, 0.25, 0.25)
    # Equal shares have Wilson's interval on request: 0 of 20 goals is no proof that none is ever reached.
    assert score(np.zeros((1, 20)), is_widened=True)[:3] == pytest.approx((0.0, 0.0, 0.161), abs=1e-3)
    assert score(np.ones((2, 10)), is_widened=True)[:3] == pytest.approx((1.0, 0.839, 1.0), abs=1e-3)
    assert score(np.full((1, 5), 7.0), is_widened=True)[:3] == (7.0, 7.0, 7.0)
    by_seed = score(np.repeat([[0.0], [0.5], [1.0]], 50, axis=1))
    assert by_seed[:3] == pytest.approx((0.5, 0.0, 1.0))
    rng = np.random.default_rng(1)
    _, low, high, *_ = score(np.tile(rng.random(100) < 0.5, (3, 1)).astype(float))  # equal in all seeds
    assert high - low == pytest.approx(4 * np.sqrt(0.25 / 100), rel=0.15)
    # Outliers among four seeds are ignored.
    assert score(np.repeat([[-9.0], [0.4], [0.6], [9.0]], 2, axis=1)).iqm == pytest.approx(0.5)


@pytest.mark.parametrize("size", [1, 2, 4])
def test_few_episodes_per_world_do_not_make_intervals_narrow(size):
    values = np.random.default_rng(0).normal(0.0, 1.0, 40)
    low, high = estimate([*values.reshape(-1, size)], statistic=np.mean)[1:3]
    assert (low, high) == pytest.approx(estimate([values], statistic=np.mean)[1:3])
    assert high - low == pytest.approx(2.0 * 1.96 * np.std(values) / np.sqrt(40.0), rel=0.15)
