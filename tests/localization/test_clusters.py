import math
from collections import Counter

import numpy as np
import pytest
from scipy.stats import norm
from sklearn.cluster import DBSCAN

from lidarnaut.envs.localization import clusters
from lidarnaut.envs.localization.clusters import find_bins, heaviest_cluster

RASTER = clusters.BinRaster.over((-2.0, -1.0, 8.0, 5.0), 0.5, math.radians(10.0))


def _heaviest(particles, weights):
    particles = np.ascontiguousarray(np.array(particles, dtype=np.float32).T)
    bins = np.empty(len(weights), dtype=np.int32)
    find_bins(particles, RASTER, bins)
    return heaviest_cluster(bins, np.array(weights), RASTER)


def test_what_lies_off_the_map_counts_to_its_edge():
    weight, members = _heaviest([(-50.0, 90.0, 3.2), (-1.9, 4.9, 3.1), (50.0, 2.0, 0.0)], [0.3, 0.3, 0.4])
    assert weight == pytest.approx(0.6)
    assert members[2] == 0.0


def test_clusters_equal_dbscan():
    """Touching bins are DBSCAN with a radius of one bin; headings wrap around."""
    rng = np.random.default_rng(8)
    for _ in range(20):
        count = int(rng.integers(2, 60))
        poses = rng.uniform((-2.0, -1.0, -math.pi), (2.0, 1.0, math.pi), (count, 3)).astype(np.float32)
        weights = rng.random(count)
        weights /= weights.sum()
        bins = np.empty(count, dtype=np.int32)
        extent = find_bins(np.ascontiguousarray(poses.T), RASTER, bins)
        cells = np.stack(np.unravel_index(bins, RASTER.shape), axis=1)
        assert extent == 1 + np.ptp(cells, axis=0).max()
        apart = np.abs(cells[:, None] - cells)
        apart[..., 2] = np.minimum(apart[..., 2], RASTER.shape[2] - apart[..., 2])
        labels = DBSCAN(eps=1.0, min_samples=1, metric="precomputed").fit_predict(apart.max(axis=-1))
        totals = np.bincount(labels, weights)
        weight, members = heaviest_cluster(bins, weights, RASTER)
        assert weight == pytest.approx(totals.max())
        np.testing.assert_array_equal(members, np.where(labels == totals.argmax(), weights, 0.0))


def test_mean_and_covariance_equal_numpy():
    rng = np.random.default_rng(5)
    factor = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.05, -0.05, 0.1]])
    poses = (rng.standard_normal((500, 3)) @ factor.T + (20.0, -7.0, math.pi)).astype(np.float32)
    wrapped = poses.copy()
    wrapped[:, 2] = (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
    weights = rng.random(500)
    covariance = np.empty((3, 3))
    mean = clusters.mean_and_covariance(np.ascontiguousarray(wrapped.T), weights, weights.sum(), covariance)
    np.testing.assert_allclose(mean[:2], np.average(poses[:, :2], axis=0, weights=weights), atol=1e-5)
    assert math.cos(mean[2] - np.average(poses[:, 2], weights=weights)) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(covariance, np.cov(poses.T.astype(float), aweights=weights, bias=True), atol=1e-4)
    assert np.linalg.eigvalsh(covariance)[0] > 0


def _draw(weights, bins, most, least, *, injected=None, share=0.0, start=0.3, error=0.05, quantile=0.99):
    n = len(weights)
    particles = np.zeros((3, n), dtype=np.float32)
    particles[0] = np.arange(n)
    drawn = np.full((3, most), np.nan, dtype=np.float32)
    injected = np.empty((3, 0), dtype=np.float32) if injected is None else injected
    seen = np.zeros(max(bins) + 1, dtype=bool)
    bins = np.array(bins, dtype=np.int32)
    kld = least, error, quantile
    count = clusters.resample(particles, np.array(weights), bins, start, kld, injected, share, seen, drawn)
    assert not seen.any()
    assert np.isfinite(drawn[:, :count]).all()
    assert np.isnan(drawn[:, count:]).all()
    return drawn[0, :count].astype(int)


def test_particles_needed_is_the_chi_square_bound():
    # Fox 2003: n = chi2 quantile(k - 1) / (2 error), by the approximation of Wilson and Hilferty.
    for k in (2, 10, 300):
        z = norm.ppf(0.99)
        expected = (k - 1) / 0.1 * (1 - 2 / (9 * (k - 1)) + math.sqrt(2 / (9 * (k - 1))) * z) ** 3
        assert clusters.particles_needed(k, 0.05, z) == pytest.approx(expected)
    assert clusters.particles_needed(1, 0.05, 2.3) == 0.0
    assert clusters.particles_needed(100, 0.01, 2.3) > 4 * clusters.particles_needed(100, 0.05, 2.3)


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
    assert len(few) == math.ceil(clusters.particles_needed(8, 0.05, 0.99))
    many = _draw(weights, np.arange(n), 50_000, 20)
    assert len(many) == math.ceil(clusters.particles_needed(n, 0.05, 0.99))
    assert len(_draw(weights, np.arange(n), 300, 20)) == 300


def test_injected_particles_get_their_share():
    injected = np.full((3, 400), -7, dtype=np.float32)
    drawn = _draw(np.full(10, 0.1), [0] * 10, 1000, 1000, injected=injected, share=0.3)
    assert np.count_nonzero(drawn == -7) in (299, 300, 301)
    assert np.all(np.bincount(drawn[drawn >= 0]) > 60)
