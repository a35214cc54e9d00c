"""Costs against Nav2's formula and SciPy's distance transform."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.geometry.distance_transform import squared_distances
from lidarnaut.envs.navigation import CostmapParams, crop_to_known, make_costmap


def grid_of(data, origin=(0.0, 0.0)):
    return OccupancyGrid(np.array(data, dtype=np.int8), 0.05, origin)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 20), st.floats(0.0, 0.3), st.integers(0, 2**32 - 1))
def test_distances_equal_scipys_up_to_the_reach(height, width, reach, density, seed):
    occupied = np.random.default_rng(seed).random((height, width)) < density
    squared = squared_distances(occupied, reach)
    expected = np.full((height, width), np.inf)
    if occupied.any():
        expected = np.rint(ndimage.distance_transform_edt(~occupied) ** 2)
    within = expected <= reach**2
    np.testing.assert_array_equal(squared[within], expected[within])
    assert (squared[~within] > reach**2).all()


def test_costs_follow_nav2():
    data = np.zeros((1, 40), dtype=np.int8)
    data[0, 0] = 100
    params = CostmapParams(robot_radius=0.25, inflation_radius=0.7, cost_scaling_factor=3.0)
    costs = make_costmap(grid_of(data), params).costs[0]
    assert costs[0] == 254
    # 0.25 m is five cells exactly: still inscribed.
    assert (costs[1:6] == 253).all()
    for k in range(6, 15):
        assert costs[k] == int(252 * np.exp(-3.0 * (0.05 * k - 0.25)))
    assert (costs[15:] == 0).all()


def test_unknown_space_is_tracked():
    data = np.full((1, 40), -1, dtype=np.int8)
    data[0, :2] = 0, 100
    data[0, 30:] = 49, 50, *[0] * 8
    costs = make_costmap(grid_of(data), CostmapParams(robot_radius=0.1, inflation_radius=0.3)).costs[0]
    assert costs[0] == 253
    assert costs[1] == 254
    # Unknown cells farther than the inscribed radius from obstacles stay unknown.
    assert (costs[2:4] == 253).all()
    assert (costs[4:29] == 255).all()
    assert costs[30] == 253
    assert costs[31] == 254


def test_cropping_keeps_what_is_known_where_it_is():
    data = np.full((20, 30), -1, dtype=np.int8)
    data[5, 7] = 0
    data[11, 3] = 100
    grid = grid_of(data, (-1.0, 2.0))
    cropped = crop_to_known(grid)
    assert cropped.data.shape == (9, 7)
    assert np.shares_memory(cropped.data, grid.data)
    for value in (0, 100):
        before = grid.centers(np.argwhere(grid.data == value))
        np.testing.assert_allclose(cropped.centers(np.argwhere(cropped.data == value)), before)
    empty = grid_of(np.full((4, 5), -1))
    assert crop_to_known(empty).data.shape == (4, 5)


def test_bad_params_are_named():
    for culprit, value in (("robot_radius", 0.0), ("inflation_radius", 0.1), ("cost_scaling_factor", -1.0)):
        with pytest.raises(ValueError, match=culprit):
            CostmapParams(**{culprit: value})
    with pytest.raises(ValueError, match="inflation_radius"):
        make_costmap(grid_of(np.zeros((3, 3))), CostmapParams(inflation_radius=20.0))
