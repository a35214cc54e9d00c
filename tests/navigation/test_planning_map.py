"""Incremental updates in windows against a full computation; scans mark and clear."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy import ndimage

from lidarnaut.envs.geometry import OccupancyGrid, Pose2D, Window
from lidarnaut.envs.navigation import PlanningMap, PlanningParams, make_costmap
from lidarnaut.envs.navigation.frontiers import frontiers
from lidarnaut.envs.navigation.frontiers.frontiers import TILE, frontier_mask
from lidarnaut.envs.navigation.maps.planning_kernels import mark
from lidarnaut.envs.robots import LidarParams, load_robot
from tests.navigation.driving import cost_at

BURGER, MOUSE = load_robot("turtlebot3_burger"), load_robot("raspimouse")
RANGES = np.array([np.nan, np.inf, 0.5, 1.5, 2.5, 3.4], dtype=np.float32)


def joined_slowly(data, block):
    height, width = (-(-size // block) for size in data.shape)
    padded = np.full((height * block, width * block), -1, dtype=np.int8)
    padded[: data.shape[0], : data.shape[1]] = data
    return padded.reshape(height, block, width, block).max(axis=(1, 3))


def expected(grid, planning, level, pose, obstacles, ignored):
    joined = OccupancyGrid(joined_slowly(grid.data, planning.block), planning.side, grid.origin)
    frontier = frontier_mask(joined)
    for row, col in joined.cells(ignored):
        frontier[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2] = False
    near = obstacles[np.hypot(*obstacles.T) <= planning.params.marking_range]
    tables = planning.tables[level]
    marked = np.maximum(joined.data, planning.marks)
    mark(marked, joined.data, joined.cells(pose.transform(near)), tables.same_obstacle)
    params = planning.params.costmap(tables.robot_radius)
    costs = make_costmap(OccupancyGrid(marked, joined.resolution, joined.origin), params).costs
    return joined.data, frontier, costs


def scan_into(grid, rng, size=30):
    height, width = grid.data.shape
    row, col = int(rng.integers(height - 2)), int(rng.integers(width - 2))
    last_row = min(row + int(rng.integers(1, size)), height - 1)
    last_col = min(col + int(rng.integers(1, size)), width - 1)
    window = Window.spanning((row, col), (last_row, last_col))
    grid.data[window.slices] = rng.choice([-1, 0, 100], (window.height, window.width), p=[0.1, 0.87, 0.03])
    return window


def grow(grid, rng):
    margins = rng.integers(0, 40, (2, 2))
    data = np.pad(grid.data, margins, constant_values=-1)
    x, y = grid.origin
    low, left = margins[:, 0].tolist()
    return data, (x - left * grid.resolution, y - low * grid.resolution)


@pytest.mark.parametrize("robot", [BURGER, MOUSE])
@pytest.mark.parametrize("seed", range(4))
def test_windows_give_what_the_whole_map_gives(robot, seed):
    rng = np.random.default_rng(seed)
    grid = OccupancyGrid(np.full((101, 130), -1, dtype=np.int8), 0.05, (-3.0, -2.0))
    planning, ignored = PlanningMap(robot, 0.05), np.empty((0, 2))
    planning.update(grid, None)
    for step in range(40):
        kind = rng.random()
        if kind < 0.08:
            grid.data, grid.origin = grow(grid, rng)
            planning.update(grid, scan_into(grid, rng))
        elif kind < 0.16:
            grid.data[:] = np.roll(grid.data, int(rng.integers(1, 9)), axis=int(rng.integers(2)))
            planning.update(grid, scan_into(grid, rng), redrawn=True)
        else:
            planning.update(grid, scan_into(grid, rng) if kind < 0.85 else None)
        if kind > 0.7:
            points = planning.grid.centers(rng.integers(0, min(grid.data.shape) // planning.block, (3, 2)))
            planning.ignore(points)
            ignored = np.concatenate([ignored, points])
        pose = Pose2D(*(grid.origin + rng.uniform(0.0, 5.0, 2)).tolist(), float(rng.uniform(-3.0, 3.0)))
        planning.integrate(pose, rng.choice(RANGES, robot.lidar.num_beams), robot.lidar)
        if kind < 0.2:
            planning.mark(pose.transform(rng.uniform(-4.0, 4.0, (3, 2))))
        elif kind < 0.4:
            planning.clear_marks(pose[:2], 0.7)
        if step % 3:
            continue
        level = int(rng.integers(len(planning.tables))) if step % 2 else 0
        obstacles = rng.uniform(-3.0, 3.0, (20, 2))
        layer = planning.layer(level, pose, obstacles)
        joined, frontier, costs = expected(grid, planning, level, pose, obstacles, ignored)
        np.testing.assert_array_equal(planning.occupancy, joined)
        np.testing.assert_array_equal(planning.frontier, frontier)
        np.testing.assert_array_equal(layer.costs, costs)
        weights = layer.tables.weights[costs]
        np.testing.assert_array_equal(layer.open_weights.reshape(np.add(costs.shape, 2)), np.pad(weights, 1))
        for (i, j), count in np.ndenumerate(planning.tile_counts):
            tile = frontier[i * TILE : (i + 1) * TILE, j * TILE : (j + 1) * TILE]
            assert count == np.count_nonzero(tile)


def test_bodies_are_marked_though_the_map_accounts_for_them():
    grid = OccupancyGrid(np.zeros((100, 100), dtype=np.int8), 0.05, (0.0, 0.0))
    grid.data[50, 60] = 100
    planning, pose = PlanningMap(BURGER, 0.05), Pose2D(2.0, 2.5, 0.0)
    planning.update(grid, None)
    beside = np.array([[1.15, 0.05]])
    cell = planning.cell(3.15, 2.55)
    assert planning.layer(0, pose, beside).costs[cell] < 254
    assert planning.layer(0, pose, bodies=beside).costs[cell] == 254
    assert planning.layer(0, pose).costs[cell] < 254


def test_groups_are_those_of_touching_cells_and_leave_the_frontier_as_it_was():
    rng = np.random.default_rng(0)
    frontier = rng.random((90, 70)) < 0.15
    counts = np.zeros((3, 3), dtype=np.int32)
    for row, col in np.argwhere(frontier):
        counts[row // TILE, col // TILE] += 1
    before = frontier.copy()
    cells, starts = frontiers.frontier_groups(frontier, counts)
    np.testing.assert_array_equal(frontier, before)
    assert sorted(map(tuple, cells.tolist())) == sorted(map(tuple, np.argwhere(before).tolist()))
    labels, count = ndimage.label(before, np.ones((3, 3)))
    assert len(starts) - 1 == count
    for first, last in itertools.pairwise(starts):
        assert len(set(labels[tuple(cells[first:last].T)])) == 1


def test_in_sight_is_what_lies_in_view_and_before_any_wall():
    rng = np.random.default_rng(1)
    joined = rng.choice(np.array([-1, 0, 100], dtype=np.int8), (60, 60), p=[0.2, 0.75, 0.05])
    frontier = frontier_mask(OccupancyGrid(joined, 0.1, (0.0, 0.0)))
    near = frontiers.frontier_near(frontier, 30, 25, 12)
    assert {tuple(cell) for cell in near.tolist()} == {
        (r, c) for r, c in np.argwhere(frontier).tolist() if (r - 30) ** 2 + (c - 25) ** 2 <= 144
    }
    found = frontiers.frontier_in_sight(joined, frontier, (30.4, 25.6), (0.3, 0.8), 12)
    slow = [
        (r, c)
        for r, c in near.tolist()
        if abs(math.remainder(math.atan2(r + 0.5 - 30.4, c + 0.5 - 25.6) - 0.3, 2.0 * math.pi)) <= 0.8
        and frontiers.is_visible(joined, 30, 25, r, c)
    ]
    assert 0 < len(slow) < len(near)
    assert [tuple(cell) for cell in found.tolist()] == slow


LIDAR = LidarParams(num_beams=360, range_max=3.5)
MIDDLE = Pose2D(0.0, 0.0, 0.0)


def marked_room(known=True, **params):
    """Map of a room of 6 m x 6 m around the origin, the middle of a cell, with planning cells of map size."""
    data = np.full((125, 125), 0 if known else -1, dtype=np.int8)
    data[[0, 1, -2, -1]] = data[:, [0, 1, -2, -1]] = 100
    planning = PlanningMap(BURGER, 0.05, PlanningParams(cell=0.05, **params))
    planning.update(OccupancyGrid(data, 0.05, (-3.125, -3.125)), None)
    return planning


def scan_of(degrees, distance, elsewhere=np.inf):
    """Scan with one hit; the first beam points backwards."""
    ranges = np.full(360, elsewhere, dtype=np.float32)
    ranges[(degrees + 180) % 360] = distance
    return ranges


def costs_of(planning):
    return planning.layer(0, MIDDLE).costs.copy()


def test_hits_mark_and_inflate_and_later_beams_clear():
    planning = marked_room()
    before = costs_of(planning)
    planning.integrate(MIDDLE, scan_of(90, 1.02), LIDAR)
    assert np.count_nonzero(planning.marks == 100) == 1
    costmap = planning.costmap(0, MIDDLE)
    assert [cost_at(costmap, 0.01, y) for y in (1.02, 1.12)] == [254, 253]
    assert 0 < cost_at(costmap, 0.01, 1.4) < 253
    planning.integrate(MIDDLE, np.full(360, np.nan, dtype=np.float32), LIDAR)  # not informative
    assert cost_at(planning.costmap(0, MIDDLE), 0.01, 1.02) == 254
    # The obstacle has gone: the beam passes through.
    planning.integrate(MIDDLE, scan_of(90, 2.0), LIDAR)
    costmap = planning.costmap(0, MIDDLE)
    assert cost_at(costmap, 0.01, 1.02) < 253
    assert cost_at(costmap, 0.01, 2.0) == 254
    # Far hits clear, and do not mark.
    planning.integrate(MIDDLE, scan_of(90, 2.6), LIDAR)
    np.testing.assert_array_equal(costs_of(planning), before)


def test_hits_near_a_wall_of_the_map_are_that_wall_and_beams_never_clear_it():
    planning = marked_room(marking_range=4.0, clearing_range=4.0)
    before = costs_of(planning)
    # The wall is 3 m away; a pose error of 0.1 m puts the hit in front of the wall.
    for distance in (2.9, np.inf):
        planning.integrate(MIDDLE, scan_of(0, distance), LIDAR)
        np.testing.assert_array_equal(costs_of(planning), before)
    planning.integrate(MIDDLE, scan_of(0, 2.7), LIDAR)
    assert np.count_nonzero(planning.marks == 100) == 1


def test_beams_start_at_the_mount_and_bad_scans_are_named():
    mounted = dataclasses.replace(LIDAR, mount=dataclasses.replace(LIDAR.mount, x=0.5, yaw=np.pi / 2))
    planning = marked_room()
    planning.integrate(Pose2D(0.0, 0.0, np.pi), scan_of(0, 1.02), mounted)
    assert cost_at(planning.costmap(0, MIDDLE), -0.5, -1.02) == 254
    with pytest.raises(ValueError, match="pose must be finite"):
        planning.integrate(Pose2D(np.nan, 0.0, 0.0), scan_of(0, 1.0), LIDAR)
    with pytest.raises(ValueError, match=r"ranges must have shape \(360,\)"):
        planning.integrate(MIDDLE, np.ones(12, dtype=np.float32), LIDAR)


def test_unknown_space_becomes_known_where_beams_pass():
    planning = marked_room(known=False)
    planning.integrate(MIDDLE, scan_of(0, 2.0, elsewhere=np.nan), LIDAR)
    costmap = planning.costmap(0, MIDDLE)
    assert [cost_at(costmap, *point) for point in ((1.0, 0.01), (1.99, 0.01), (0.0, 1.0))] == [0, 254, 255]


def test_clearing_forgets_what_scans_found():
    planning = marked_room()
    before = costs_of(planning)
    planning.integrate(MIDDLE, np.minimum(scan_of(0, 1.0), scan_of(180, 1.0)), LIDAR)
    planning.clear_marks((1.0, 0.0), 0.2)
    assert np.count_nonzero(planning.marks == 100) == 1
    assert cost_at(planning.costmap(0, MIDDLE), -0.99, 0.01) == 254
    planning.clear_marks()
    np.testing.assert_array_equal(costs_of(planning), before)
