import math

import numpy as np
import pytest

from lidarnaut.envs.estimation import NO_CELLS, NO_UPDATE, MapUpdate
from lidarnaut.envs.estimation.map_pyramid import MapPyramid, crop_level
from lidarnaut.envs.estimation.trail import Trail
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D, Window
from lidarnaut.envs.observations import FAR_PIXEL, NEAR_PIXEL
from tests.kernel_references import crop_in_numpy, pool_in_numpy

SIZE = 40


def random_grid(resolution=0.05):
    values = np.array([-1, 0, 30, 50, 100], dtype=np.int8)
    data = np.random.default_rng(3).choice(values, size=(150, 131), p=[0.5, 0.3, 0.17, 0.02, 0.01])
    return OccupancyGrid(data, resolution, (-3.5, -4.2))


def crops(pyramid, pose, *pixels):
    """Return crops of these pixel sizes, by default near and far: shape (n, 3, SIZE, SIZE)."""
    pixels = pixels or (NEAR_PIXEL, FAR_PIXEL)
    out = np.empty((len(pixels), 3, SIZE, SIZE), dtype=np.uint8)
    for pixel, crop in zip(pixels, out):
        level, (left, low) = pyramid.level(pixel), pyramid.grid.origin
        side = level.block * pyramid.grid.resolution
        x, y = (pose.x - left) / side, (pose.y - low) / side
        crop_level(level.words, level.height, level.width, x, y, pose.theta, pixel / side, crop)
    return out


def trail_of(*positions):
    trail = Trail()
    for x, y in positions:
        trail.append(Pose2D(x, y, 0.0))
    return trail


@pytest.mark.parametrize("resolution", [0.05, 0.07, 0.025, 0.4])
@pytest.mark.parametrize("pixel", [0.1, NEAR_PIXEL, FAR_PIXEL])
def test_crops_equal_slow_ones(resolution, pixel):
    grid, pose = random_grid(resolution=resolution), Pose2D(0.83, -0.41, 2.1)
    x_min, y_min, x_max, y_max = grid.bounds
    trail = trail_of(*np.random.default_rng(1).uniform((x_min, y_min), (x_max, y_max), size=(300, 2)))
    block = 2 ** max(round(math.log2(pixel / resolution)), 0)
    (shown,) = crops(MapPyramid(grid, [trail]), pose, pixel)
    side = block * resolution
    pooled = pool_in_numpy(grid.data, grid.cells(trail.positions), block)
    x, y = pose.x - grid.origin[0], pose.y - grid.origin[1]
    slow = crop_in_numpy(pooled, x / side, y / side, pose.theta, pixel / side, SIZE)
    assert shown.any(axis=(1, 2)).all()
    # Look-ups at borders between blocks may round either way in single precision. Shares of free cells are rounded once
    # per level.
    off = (shown[0] != slow[0]) | (np.abs(shown[1].astype(int) - slow[1]) > 1) | (shown[2] != slow[2])
    assert off.mean() < 0.005


@pytest.mark.parametrize("windows", [[Window(41, 13, 37, 89)], [Window(41, 13, 10, 28), Window(60, 90, 18, 12)], None])
def test_a_crop_shows_what_has_changed_since_the_last_one(windows):
    """Changes are in some windows, or anywhere for None, with another trail."""
    grid, trail, pose = random_grid(), trail_of((0.5, 0.5)), Pose2D(0.2, 0.1, 0.4)
    pyramid = MapPyramid(grid, [trail])
    before = crops(pyramid, pose)
    for window in windows or []:
        grid.data[window.slices] = 0
        pyramid.update(MapUpdate(NO_CELLS, window))
    trail.append(Pose2D(-0.5, 0.7, 0.0))
    pyramid.mark(-0.5, 0.7)
    if windows is None:
        grid.data[:] = np.roll(grid.data, 20, axis=1)
        trail.replace(np.array([[1.5, 0.5], [1.5, 1.0]]))
        pyramid.update(MapUpdate(NO_CELLS, None, redrawn=True))
    shown = crops(pyramid, pose)
    np.testing.assert_array_equal(shown, crops(MapPyramid(grid, [trail]), pose))
    assert (shown != before).any(axis=(1, 2, 3)).all()


@pytest.mark.parametrize("pixels", [(NEAR_PIXEL, FAR_PIXEL), (0.1, 6.4)])
@pytest.mark.parametrize("counts", [(7, 9), (60, 0, 3), (3, 4000)])
def test_a_crop_shows_cells_that_an_update_names(counts, pixels):
    """Few cells are pooled one by one, many with all others; the rest of the window is as it was."""
    grid, rng, pose = random_grid(), np.random.default_rng(4), Pose2D(0.2, 0.1, 0.4)
    pyramid = MapPyramid(grid, [trail_of((0.5, 0.5))])
    before = crops(pyramid, pose, *pixels)
    for count in counts:
        cells = rng.integers((0, 0), grid.data.shape, size=(count, 2)).astype(np.int32)
        is_new = grid.data[tuple(cells.T)] < 0
        grid.data[tuple(cells.T)] = rng.choice([0, 30, 50, 100], count)
        window = Window(0, 0, *grid.data.shape)
        pyramid.update(MapUpdate(cells[is_new], window, origin=grid.origin, changed_cells=cells[~is_new]))
    shown = crops(pyramid, pose, *pixels)
    np.testing.assert_array_equal(shown, crops(MapPyramid(grid, [trail_of((0.5, 0.5))]), pose, *pixels))
    assert (shown != before).any()


@pytest.mark.parametrize(
    ("names", "shift"),
    [
        ([[[70, 60]]], 0.5),  # cells counted from another origin
        ([NO_CELLS, None, NO_CELLS], 0.0),  # with and without changed cells
    ],
)
def test_a_crop_shows_changes_that_an_update_does_not_name_as_cells(names, shift):
    grid, pose, window = random_grid(), Pose2D(0.2, 0.1, 0.4), Window(70, 60, 20, 30)
    pyramid = MapPyramid(grid, [])
    crops(pyramid, pose)
    origin = grid.origin[0] + shift, grid.origin[1] + shift
    for cells in names:
        is_named = cells is NO_CELLS
        if not is_named:
            grid.data[window.slices] = 0
        changed = None if cells is None else np.array(cells, dtype=np.int32)
        pyramid.update(MapUpdate(NO_CELLS, Window(1, 1, 1, 1) if is_named else window, False, origin, None, changed))
    np.testing.assert_array_equal(crops(pyramid, pose), crops(MapPyramid(grid, []), pose))


def test_without_an_update_nothing_changes():
    grid, pose = random_grid(), Pose2D(0.2, 0.1, 0.4)
    pyramid = MapPyramid(grid, [])
    before = crops(pyramid, pose)
    grid.data[:] = 0
    pyramid.update(NO_UPDATE)
    np.testing.assert_array_equal(crops(pyramid, pose), before)


def test_a_grown_map_is_pooled_anew_and_keeps_where_the_robot_was():
    grid, trail = random_grid(), trail_of((0.5, 0.5), (-1.0, 2.0))
    pyramid = MapPyramid(grid, [trail])
    pose = Pose2D(0.2, 0.1, 0.0)
    before = crops(pyramid, pose)
    grid.data = np.pad(grid.data, ((160, 0), (80, 40)), constant_values=-1)
    grid.origin = (grid.origin[0] - 80 * 0.05, grid.origin[1] - 160 * 0.05)
    pyramid.update(NO_UPDATE)
    shown = crops(pyramid, pose)
    assert shown.any(axis=(2, 3)).all()
    assert np.mean(shown != before, axis=(1, 2, 3)).max() < 0.005  # borders between blocks, in single precision
