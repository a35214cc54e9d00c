"""Frontier kernels against SciPy and brute force."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from envs.geometry import OccupancyGrid
from envs.navigation.frontiers import frontier_mask, information_gain

EIGHT = np.ones((3, 3), dtype=bool)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 30), st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_mask_equals_a_dilation_of_the_unknown(height, width, seed):
    values = np.array([-1, 0, 0, 0, 30, 49, 50, 100], dtype=np.int8)
    rng = np.random.default_rng(seed)
    data = values[rng.integers(0, len(values), (height, width))]
    free = (data >= 0) & (data < 50)
    expected = free & ndimage.binary_dilation(data == -1, structure=EIGHT)
    np.testing.assert_array_equal(frontier_mask(OccupancyGrid(data, 0.05, (0.0, 0.0))), expected)


@settings(max_examples=30, deadline=None)
@given(st.integers(-3, 14), st.integers(-3, 14), st.floats(0.5, 9.0), st.integers(0, 2**32 - 1))
def test_unknown_cells_are_counted_also_outside(row, col, radius, seed):
    data = np.random.default_rng(seed).integers(-1, 2, (10, 12)).astype(np.int8)
    padded = np.full((50, 52), -1, dtype=np.int8)
    padded[20:30, 20:32] = data
    rows, cols = np.mgrid[-20:30, -20:32]
    disc = (rows - row) ** 2 + (cols - col) ** 2 <= radius**2
    point = np.array([[col + 0.5, row + 0.5]])
    assert information_gain(OccupancyGrid(data, 1.0, (0.0, 0.0)), point, radius) == np.count_nonzero(padded[disc] == -1)
