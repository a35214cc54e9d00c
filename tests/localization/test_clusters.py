import math

import numpy as np
import pytest
from sklearn.cluster import DBSCAN

from lidarnaut.envs.localization.clusters import BinRaster, find_bins, heaviest_cluster, mean_and_covariance

RASTER = BinRaster.over((-2.0, -1.0, 8.0, 5.0), 0.5, math.radians(10.0))


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
    mean = mean_and_covariance(np.ascontiguousarray(wrapped.T), weights, weights.sum(), covariance)
    np.testing.assert_allclose(mean[:2], np.average(poses[:, :2], axis=0, weights=weights), atol=1e-5)
    assert math.cos(mean[2] - np.average(poses[:, 2], weights=weights)) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(covariance, np.cov(poses.T.astype(float), aweights=weights, bias=True), atol=1e-4)
    assert np.linalg.eigvalsh(covariance)[0] > 0
