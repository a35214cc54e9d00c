import math
from collections import Counter

import numpy as np
import pytest
from scipy.stats import norm

from lidarnaut.envs.localization.clusters import particles_needed, resample


def _draw(weights, bins, most, least, *, injected=None, share=0.0, start=0.3, error=0.05, quantile=0.99):
    n = len(weights)
    particles = np.zeros((3, n), dtype=np.float32)
    particles[0] = np.arange(n)
    drawn = np.full((3, most), np.nan, dtype=np.float32)
    injected = np.empty((3, 0), dtype=np.float32) if injected is None else injected
    seen = np.zeros(max(bins) + 1, dtype=bool)
    bins = np.array(bins, dtype=np.int32)
    kld = least, error, quantile
    count = resample(particles, np.array(weights), bins, start, kld, injected, share, seen, drawn)
    assert not seen.any()
    assert np.isfinite(drawn[:, :count]).all()
    assert np.isnan(drawn[:, count:]).all()
    return drawn[0, :count].astype(int)


def test_particles_needed_is_the_chi_square_bound():
    # Fox 2003: n = chi2 quantile(k - 1) / (2 error), by the approximation of Wilson and Hilferty.
    for k in (2, 10, 300):
        z = norm.ppf(0.99)
        expected = (k - 1) / 0.1 * (1 - 2 / (9 * (k - 1)) + math.sqrt(2 / (9 * (k - 1))) * z) ** 3
        assert particles_needed(k, 0.05, z) == pytest.approx(expected)
    assert particles_needed(1, 0.05, 2.3) == 0.0
    assert particles_needed(100, 0.01, 2.3) > 4 * particles_needed(100, 0.05, 2.3)


@pytest.mark.parametrize("start", [0.0, 0.37, 0.999999])
def test_draws_have_low_variance_whenever_they_stop(start):
    rng = np.random.default_rng(1)
    weights = rng.random(300) ** 4
    weights[::7] = 0.0
    weights /= weights.sum()
    bins = np.zeros(300, dtype=int)
    for count in (50, 333, 2000):
        drawn = Counter(_draw(weights, bins, count, count, start=start).tolist())
        off = [abs(drawn[i] - count * weights[i]) for i in range(300)]
        assert max(off) < 2.5  # independent draws miss the heaviest by up to 20
        assert not any(drawn[i] for i in range(0, 300, 7))


def test_number_follows_the_bins():
    n = 400
    weights = np.full(n, 1 / n)
    assert len(_draw(weights, [3] * n, 5000, 100)) == 100
    few = _draw(weights, np.arange(n) % 8, 5000, 20)
    assert len(few) == math.ceil(particles_needed(8, 0.05, 0.99))
    many = _draw(weights, np.arange(n), 50_000, 20)
    assert len(many) == math.ceil(particles_needed(n, 0.05, 0.99))
    assert len(_draw(weights, np.arange(n), 300, 20)) == 300


def test_injected_particles_get_their_share():
    injected = np.full((3, 400), -7, dtype=np.float32)
    drawn = _draw(np.full(10, 0.1), [0] * 10, 1000, 1000, injected=injected, share=0.3)
    assert np.count_nonzero(drawn == -7) in (299, 300, 301)
    assert np.all(np.bincount(drawn[drawn >= 0]) > 60)
