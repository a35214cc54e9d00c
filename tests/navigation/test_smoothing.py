"""Paths that are refused, and smoothing."""

import numpy as np

from envs.geometry import OccupancyGrid
from envs.geometry.polyline import resample
from envs.navigation import CostmapParams, is_path_valid, make_costmap, plan_path, smooth_path
from tests.navigation.costs import cost_at

PARAMS = CostmapParams(robot_radius=0.2, inflation_radius=0.6)


def hall():
    """6 m x 3 m, unknown beyond x = 5, with a wall to the height of 2 m at x = 2."""
    data = np.zeros((60, 120), dtype=np.int8)
    data[:, 100:] = -1
    data[[0, -1]] = data[:, [0, -1]] = 100
    data[:40, 40] = 100
    return OccupancyGrid(data, 0.05, (0.0, 0.0))


COSTMAP = make_costmap(hall(), PARAMS)


def test_a_path_is_valid_until_an_obstacle_blocks_it():
    path = plan_path(COSTMAP, (1.0, 0.5), (3.0, 0.5))
    assert is_path_valid(COSTMAP, path)
    grid = hall()
    grid.data[50, 40] = 100
    assert not is_path_valid(make_costmap(grid, PARAMS), path)
    # What has been passed does not count.
    assert is_path_valid(make_costmap(grid, PARAMS), path[-20:])


def test_a_path_through_the_unknown_or_off_the_map_is_not_valid():
    line = resample(np.array([[4.0, 1.5], [5.5, 1.5]]), 0.05)
    assert not is_path_valid(COSTMAP, line)
    assert is_path_valid(COSTMAP, line, allow_unknown=True)
    assert not is_path_valid(COSTMAP, line + (5.0, 0.0), allow_unknown=True)


def test_a_path_may_begin_where_the_robot_touches_something_but_not_return_there():
    out = resample(np.array([[1.85, 1.0], [1.0, 1.0]]), 0.05)
    assert cost_at(COSTMAP, *out[0]) == 253
    assert is_path_valid(COSTMAP, out)
    assert not is_path_valid(COSTMAP, out[::-1])
    assert not is_path_valid(COSTMAP, out[:1])


def turning(path):
    """Sum of squared turns per step, of chords long enough not to see the raster."""
    chords = path[4:] - path[:-4]
    angles = np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))
    return float((np.diff(angles) ** 2).sum())


def test_smoothing_rounds_corners_and_touches_nothing():
    path = plan_path(COSTMAP, (1.0, 0.5), (3.0, 0.5))
    smooth = smooth_path(COSTMAP, path)
    np.testing.assert_allclose(smooth[[0, -1]], path[[0, -1]])
    assert turning(smooth) < 0.7 * turning(path)
    assert is_path_valid(COSTMAP, smooth)
    assert np.hypot(*np.diff(smooth, axis=0).T).max() <= 0.05 + 1e-9
    corner = resample(np.array([[1.7, 1.0], [1.7, 2.3], [2.4, 2.3], [2.4, 1.0]]), 0.05)
    assert is_path_valid(COSTMAP, smooth_path(COSTMAP, corner))
    assert len(smooth_path(COSTMAP, path[:1])) == 1
    # A straight line stays one.
    line = resample(np.array([[0.5, 2.5], [4.5, 2.5]]), 0.05)
    np.testing.assert_allclose(smooth_path(COSTMAP, line), line, atol=1e-9)
