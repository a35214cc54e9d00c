"""Frontier kernels against SciPy and brute force."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from sklearn.cluster import DBSCAN

from envs.geometry import OccupancyGrid
from envs.navigation import clear_around, count_unknown, dbscan, frontier_clusters, frontier_mask

EIGHT = np.ones((3, 3), dtype=bool)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 30), st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_mask_equals_the_dilation_of_seed_3(height, width, seed):
    values = np.array([-1, 0, 0, 0, 30, 49, 50, 100], dtype=np.int8)
    rng = np.random.default_rng(seed)
    data = values[rng.integers(0, len(values), (height, width))]
    free = (data >= 0) & (data < 50)
    expected = free & ndimage.binary_dilation(data == -1, structure=EIGHT)
    np.testing.assert_array_equal(frontier_mask(OccupancyGrid(data, 0.05, (0.0, 0.0))), expected)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 25), st.integers(1, 25), st.floats(0.0, 0.7), st.integers(0, 2**32 - 1))
def test_clusters_equal_scipys_labels(height, width, density, seed):
    mask = np.random.default_rng(seed).random((height, width)) < density
    before = mask.copy()
    clusters = frontier_clusters(mask)
    np.testing.assert_array_equal(mask, before)
    labels, count = ndimage.label(mask, structure=EIGHT)
    assert len(clusters) == count
    assert sum(map(len, clusters)) == np.count_nonzero(mask)
    for cluster in clusters:
        label = labels[tuple(cluster[0])]
        assert {tuple(cell) for cell in cluster} == {tuple(cell) for cell in np.argwhere(labels == label)}


@settings(max_examples=30, deadline=None)
@given(st.integers(-3, 14), st.integers(-3, 14), st.floats(0.5, 9.0), st.integers(0, 2**32 - 1))
def test_unknown_cells_are_counted_also_outside(row, col, radius, seed):
    data = np.random.default_rng(seed).integers(-1, 2, (10, 12)).astype(np.int8)
    padded = np.full((50, 52), -1, dtype=np.int8)
    padded[20:30, 20:32] = data
    rows, cols = np.mgrid[-20:30, -20:32]
    disc = (rows - row) ** 2 + (cols - col) ** 2 <= radius**2
    assert count_unknown(data, row, col, radius) == np.count_nonzero(padded[disc] == -1)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(1, 30),
    st.integers(1, 30),
    st.floats(0.0, 0.5),
    st.sampled_from([1.0, 1.5, 3.0, 4.0]),
    st.integers(1, 9),
    st.integers(0, 2**32 - 1),
)
def test_density_clusters_equal_scikit_learns(height, width, density, eps, min_samples, seed):
    mask = np.random.default_rng(seed).random((height, width)) < density
    labels, count = dbscan(mask, eps, min_samples)
    assert (labels[~mask] == -1).all()
    cells = np.argwhere(mask)
    expected = DBSCAN(eps=eps, min_samples=min_samples).fit(cells).labels_ if len(cells) else np.empty(0)
    np.testing.assert_array_equal(labels[mask], expected)
    assert count == expected.max(initial=-1) + 1


def test_clearing_says_what_was_of_use():
    mask = np.zeros((8, 8), dtype=bool)
    mask[2, 2] = mask[2, 3] = mask[7, 7] = True
    cells = np.array([[1, 1], [2, 4], [5, 5], [7, 7], [-1, 3], [-3, -3], [20, 7]])
    np.testing.assert_array_equal(clear_around(mask, cells), [True, True, False, True, False, False, False])
    assert not mask.any()
