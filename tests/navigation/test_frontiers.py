import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.navigation.frontiers.frontiers import frontier_mask, information_gain
from lidarnaut.envs.navigation.frontiers.views import (
    NUM_RAYS,
    NUM_SECTORS,
    cast_view,
    fill_sectors,
    unknown_share,
    visible_gain,
)

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


def view(data, row, col, reach):
    free, unknown = np.empty(NUM_RAYS), np.empty(NUM_RAYS)
    outward = cast_view(data, row, col, reach, free, unknown)
    return free, unknown, outward


def test_occupied_cells_end_a_ray_and_unknown_ones_do_not():
    data = np.full((101, 101), -1, dtype=np.int8)
    free, unknown, _ = view(data, 50, 50, 40)
    assert (free == 40).all()
    assert unknown.sum() == pytest.approx(math.pi * 40**2, rel=0.03)
    np.testing.assert_allclose(view(data[:60, :60], 50, 50, 40)[1], unknown)
    data[:, 60] = 100
    data[50, 50] = 0
    free, unknown, outward = view(data, 50, 50, 40)
    assert free[0] == 9
    assert unknown[0] == pytest.approx(2.0 * math.pi / NUM_RAYS * 45)
    assert free[NUM_RAYS // 2] == 40
    assert outward == NUM_RAYS // 2


def test_sectors_turn_with_the_outward_direction():
    rng = np.random.default_rng(0)
    free, unknown = rng.uniform(0.0, 20.0, NUM_RAYS), rng.uniform(0.0, 10.0, NUM_RAYS)
    first, second = np.empty((2, 2 * NUM_SECTORS), dtype=np.float32)
    fill_sectors(free, unknown, 0, 20, first)
    fill_sectors(free, unknown, 10, 20, second)
    np.testing.assert_array_equal(np.roll(second.reshape(2, -1), 5, axis=1), first.reshape(2, -1))
    assert first[0] == pytest.approx(min(free[:2]) / 20)
    assert first[NUM_SECTORS] == pytest.approx(unknown[:2].sum() / (2.0 * math.pi * 20 * 21 / NUM_RAYS))


@pytest.mark.parametrize("radius", [5.0, 10.0, 40.0])
def test_unknown_share_of_a_disc(radius):
    data = np.zeros((101, 101), dtype=np.int8)
    assert unknown_share(data, 50, 50, radius) == 0.0
    data[51:] = -1
    assert unknown_share(data, 50, 50, radius) == pytest.approx(0.5, abs=0.5 * 2.5 / math.sqrt(math.pi * 100))
    assert unknown_share(data[:51], 50, 50, radius) == unknown_share(data, 50, 50, radius)


def test_gain_in_view_counts_unknown_cells_before_obstacles_and_inside_the_observed_bounds():
    # 4 m x 4 m observed: free, with an unknown strip at x > 3, and a wall that hides a part of it.
    data = np.full((120, 120), -1, dtype=np.int8)
    data[20:100, 20:100] = 0
    data[20:100, 80:99] = -1
    grid = OccupancyGrid(data, 0.05, (-1.0, -1.0))
    point = np.array([[2.975, 2.025], [1.025, 2.025]])
    # Half of the disc of 0.5 m is unknown; the left side has none within reach, though it is near the bounds.
    np.testing.assert_allclose(visible_gain(grid, point, 0.5), [0.5 * math.pi * 0.25, 0.0], rtol=0.12)
    assert visible_gain(grid, np.array([[0.1, 2.0]]), 0.5)[0] == 0.0
    # Unknown area beyond x = 4 m is outside the bounds: the strip of 1 m has 4 m2.
    assert visible_gain(grid, point, 50.0)[0] == pytest.approx(4.0 * 0.95, rel=0.15)
    data[20:100, 80] = 100
    assert visible_gain(grid, point, 50.0).tolist() == [0.0, 0.0]
    assert visible_gain(grid, np.empty((0, 2)), 1.0).shape == (0,)
