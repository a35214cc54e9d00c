import math

import numpy as np
import pytest

from lidarnaut.agents.completion.raster import (
    CELL,
    FREE,
    MARGIN,
    OCCUPIED,
    STRIDE,
    true_floor,
    turned_raster,
    wall_direction,
)
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.tasks.explore import Explore


def room(angle, resolution=0.05, size=(6.0, 3.0)):
    """A map with the walls of a room around the origin, turned by an angle."""
    side = round(10.0 / resolution)
    grid = OccupancyGrid(np.full((side, side), -1, dtype=np.int8), resolution, (-5.0, -5.0))
    x, y = grid.centers(np.argwhere(grid.data < 0)).T
    u, v = math.cos(angle) * x + math.sin(angle) * y, math.cos(angle) * y - math.sin(angle) * x
    outside = np.maximum(np.abs(u) - 0.5 * size[0], np.abs(v) - 0.5 * size[1])
    grid.data.reshape(-1)[outside < 0.1] = 100
    grid.data.reshape(-1)[outside < 0.0] = 0
    return grid


@pytest.mark.parametrize("degrees", [0.0, 7.5, 30.0, 44.0, 61.0, 89.5])
def test_rasters_are_turned_to_the_walls(degrees):
    angle = wall_direction(room(math.radians(degrees)))
    gap = (math.degrees(angle) - degrees + 45.0) % 90.0 - 45.0
    assert abs(gap) <= 1.0


def test_a_direction_is_kept_unless_another_one_is_clearly_better():
    grid = room(math.radians(30.0))
    assert wall_direction(grid, math.radians(29.9)) == math.radians(29.9)
    assert math.degrees(wall_direction(grid, math.radians(10.0))) % 90.0 == pytest.approx(30.0, abs=1.0)
    grid.data[:] = -1
    assert wall_direction(grid) == 0.0
    assert wall_direction(grid, 0.4) == 0.4


@pytest.mark.parametrize("resolution", [0.02, 0.05, 0.1, 0.25])
def test_known_cells_lie_where_the_map_has_them(resolution):
    angle = math.radians(30.0)
    raster = turned_raster(room(angle, resolution), angle)
    rows, cols = np.nonzero(raster.codes & FREE)
    u, v = raster.corner[0] + (cols + 0.5) * CELL, raster.corner[1] + (rows + 0.5) * CELL
    slack = CELL + resolution
    assert np.abs(u).max() == pytest.approx(3.0, abs=slack)
    assert np.abs(v).max() == pytest.approx(1.5, abs=slack)
    assert np.count_nonzero(raster.codes & FREE) * CELL**2 == pytest.approx(18.0, rel=0.25)
    assert (raster.codes & OCCUPIED).any()
    # The border is unknown and at least as wide as promised.
    assert not raster.codes[: round(0.8 * MARGIN / CELL)].any()
    assert not raster.codes[:, -round(0.8 * MARGIN / CELL) :].any()


def test_corners_do_not_shift_cells_when_a_map_grows():
    small, large = (turned_raster(room(0.0, size=size), 0.0) for size in ((2.0, 2.0), (8.0, 6.0)))
    for raster in (small, large):
        assert all(size % STRIDE == 0 for size in raster.codes.shape)
        assert all(abs(place / MARGIN - round(place / MARGIN)) < 1e-9 for place in raster.corner)


def test_true_floor_is_that_of_the_world_in_the_frame_of_the_map():
    env = LidarEnv(Explore, world="turtlebot3_world", physics="kinematic", slam="truth")
    env.reset(seed=3)
    for _ in range(40):
        env.step(np.array([0.5, 0.4], dtype=np.float32))
    raster = turned_raster(env.belief.grid, 0.7)
    floor, is_free = true_floor(env.task.coverage, raster), raster.codes == FREE
    assert floor[is_free].mean() > 0.97
    assert floor.sum() * CELL**2 == pytest.approx(env.task.coverage.area.area, rel=0.1)
    env.close()
