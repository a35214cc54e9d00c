import math

import numpy as np
import pytest

from benchmarks.speed.references import crop_in_numpy, pool_in_numpy
from envs.geometry import OccupancyGrid, Pose2D
from envs.map_pyramid import CROP_SIZE, FAR_PIXEL, NEAR_PIXEL, MapPyramid

NOWHERE = np.empty((0, 2))


def random_grid(height=150, width=131, resolution=0.05):
    values = np.array([-1, 0, 30, 50, 100], dtype=np.int8)
    data = np.random.default_rng(3).choice(values, size=(height, width), p=[0.5, 0.3, 0.17, 0.02, 0.01])
    return OccupancyGrid(data, resolution, (-3.5, -4.2))


def crops(pyramid, pose):
    near = np.empty((3, CROP_SIZE, CROP_SIZE), dtype=np.uint8)
    far = np.empty_like(near)
    pyramid.crop(*pose, near, far)
    return near, far


@pytest.mark.parametrize("resolution", [0.05, 0.07, 0.025, 0.4])
def test_crops_equal_slow_ones(resolution):
    grid, pose = random_grid(resolution=resolution), Pose2D(0.83, -0.41, 2.1)
    x_min, y_min, x_max, y_max = grid.bounds
    visited = np.random.default_rng(1).uniform((x_min, y_min), (x_max, y_max), size=(300, 2))
    pyramid = MapPyramid(grid)
    for x, y in visited:
        pyramid.mark(x, y)
    x, y = pose.x - grid.origin[0], pose.y - grid.origin[1]
    for crop, blocks, pixel in zip(crops(pyramid, pose), (1, 4), (NEAR_PIXEL, FAR_PIXEL), strict=True):
        side = blocks * pyramid.block * resolution
        pooled = pool_in_numpy(grid.data, grid.cells(visited), blocks * pyramid.block)
        slow = crop_in_numpy(pooled, x / side, y / side, pose.theta, pixel / side, CROP_SIZE)
        assert crop.any(axis=(1, 2)).all()
        # Look-ups that fall on a border between blocks may go either way in single precision. Shares of free cells are
        # rounded once per level.
        off = (crop[0] != slow[0]) | (np.abs(crop[1].astype(int) - slow[1]) > 1) | (crop[2] != slow[2])
        assert off.mean() < 0.005


def test_what_was_touched_is_all_that_needs_pooling():
    grid = random_grid()
    pyramid = MapPyramid(grid)
    pyramid.mark(0.5, 0.5)
    grid.data[41:78, 13:102] = 0
    pyramid.update((13, 41, 101, 77), NOWHERE)
    fresh = MapPyramid(grid)
    fresh.mark(0.5, 0.5)
    np.testing.assert_array_equal(pyramid.near, fresh.near)
    np.testing.assert_array_equal(pyramid.far, fresh.far)


def test_nothing_touched_changes_nothing():
    grid = random_grid()
    pyramid = MapPyramid(grid)
    before = pyramid.near.copy()
    grid.data[:] = 0
    pyramid.update(None, NOWHERE)
    np.testing.assert_array_equal(pyramid.near, before)


def test_a_grown_map_is_pooled_anew_and_keeps_where_the_robot_was():
    grid, visited = random_grid(), np.array([[0.5, 0.5], [-1.0, 2.0]])
    pyramid = MapPyramid(grid)
    for x, y in visited:
        pyramid.mark(x, y)
    before = crops(pyramid, Pose2D(0.2, 0.1, 0.0))
    grid.data = np.pad(grid.data, ((160, 0), (80, 40)), constant_values=-1)
    grid.origin = (grid.origin[0] - 80 * 0.05, grid.origin[1] - 160 * 0.05)
    pyramid.update(None, visited)
    for crop, old in zip(crops(pyramid, Pose2D(0.2, 0.1, 0.0)), before, strict=True):
        assert crop.any(axis=(1, 2)).all()
        assert np.mean(crop != old) < 0.005  # borders between blocks, in single precision


def test_crops_point_forward_and_left():
    data = np.full((200, 200), -1, dtype=np.int8)
    # The robot stands at the origin and looks along +y; a wall lies 2 m ahead, free space 2 m to its left (-x).
    data[140:144, 96:104] = 100
    data[96:104, 58:62] = 0
    near, _ = crops(MapPyramid(OccupancyGrid(data, 0.05, (-5.0, -5.0))), Pose2D(0.01, 0.01, math.pi / 2))
    ahead = np.argwhere(near[0])
    assert (ahead[:, 0] >= 29).all()
    assert ahead[:, 1].mean() == pytest.approx(19.5, abs=1.1)
    left = np.argwhere(near[1])
    assert (left[:, 1] >= 28).all()
    assert left[:, 0].mean() == pytest.approx(19.5, abs=1.1)


@pytest.mark.parametrize("theta", np.linspace(0.0, 1.5, 7))
def test_no_thin_wall_is_lost(theta):
    """A wall of single cells is seen in most of the pixels that it crosses, however the robot is turned."""
    data = np.zeros((640, 640), dtype=np.int8)
    data[340, :] = 100
    pyramid = MapPyramid(OccupancyGrid(data, 0.05, (-16.0, -16.0)))
    near, far = crops(pyramid, Pose2D(0.0, 0.0, theta))
    for crop in (near, far):
        seen = np.flatnonzero(crop[0].any(axis=1 if abs(math.cos(theta)) > 0.7 else 0))
        length = seen[-1] - seen[0] + 1
        assert length >= 15
        assert len(seen) >= 0.9 * length
