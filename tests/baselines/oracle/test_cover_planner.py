from itertools import pairwise

import numpy as np

from lidarnaut.baselines.oracle.cover_planner import CoverPlanner
from lidarnaut.baselines.oracle.cover_viewpoints import find_viewpoints, pack_bits, views_from
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation import CostmapParams, make_costmap
from lidarnaut.envs.worlds import World, explorable_area
from tests.baselines.maps import BURGER

REACH = BURGER.lidar.range_max
FOOTPRINT = CostmapParams(0.155, 0.605, 4.0)


def world_of(*corners, walls=(), start=(1.0, 1.0)):
    """Floor with an outline of the given corners, counter-clockwise, and further walls."""
    outline = [(*a, *b) for a, b in zip(corners, (*corners[1:], corners[0]))]
    x, y = np.array(corners, dtype=float).T
    return World(
        name="plan",
        segments=np.array([*outline, *walls], dtype=float),
        circles=np.empty((0, 3)),
        spawns=(Pose2D(*start, 0.0),),
        bounds=(x.min(), y.min(), x.max(), y.max()),
    )


def corridor(x):
    return world_of((0, 0), (20, 0), (20, 2), (0, 2), start=(x, 1.0))


def planner_for(world, target=1.0):
    area = explorable_area(world, BURGER, 0.05)
    viewpoints = find_viewpoints(make_costmap(area.walls, FOOTPRINT), world.spawns[0][:2])
    return CoverPlanner(area, viewpoints, REACH, target, np.random.default_rng(0))


def seen_from(planner, point):
    area = planner.area
    cells = np.argwhere(area.explorable)
    words = views_from(area.walls.data == 0, area.walls.cells(np.array([point])), REACH / 0.05, cells)
    flags = np.unpackbits(words[0].view(np.uint8), bitorder="little")[: len(cells)]
    seen = np.zeros_like(area.explorable)
    seen[tuple(cells.T)] = flags.astype(bool)
    return seen


def test_views_equal_a_look_along_every_line():
    rng = np.random.default_rng(0)
    free = rng.random((50, 60)) < 0.93
    free[[0, -1]] = free[:, [0, -1]] = False
    samples = np.argwhere(free)[::3]
    viewpoints, reach = np.array([[20, 25], [2, 3], [47, 57]]), 14.0
    expected = np.zeros((len(viewpoints), len(samples)), dtype=bool)
    for k, viewpoint in enumerate(viewpoints):
        seen = np.zeros_like(free)
        seen[tuple(viewpoint)] = True
        num_lines = int(np.ceil(2.0 * np.pi * reach))
        for angle in 2.0 * np.pi * np.arange(num_lines) / num_lines:
            step = np.array([np.sin(angle), np.cos(angle)])
            longer = np.abs(step).max()
            steps = np.outer(np.arange(1, int(reach * longer) + 1), step / longer)
            cells = np.floor(viewpoint + 0.5 + steps).astype(int)
            cells = cells[((cells >= 0) & (cells < free.shape)).all(axis=1)]
            cells = cells[np.logical_and.accumulate(free[tuple(cells.T)])]
            seen[tuple(cells.T)] = True
        expected[k] = seen[tuple(samples.T)]
    views = views_from(free, viewpoints, reach, samples)
    np.testing.assert_array_equal(views, np.array([pack_bits(flags) for flags in expected]))


def test_viewpoints_are_spread_evenly_and_paths_lead_around_walls_through_those_that_lie_on_them():
    viewpoints = planner_for(world_of((0, 0), (10, 0), (10, 6), (0, 6), walls=[(5, 0, 5, 4)])).viewpoints
    gaps = np.hypot(*(viewpoints.points[:, None] - viewpoints.points).transpose(2, 0, 1))
    np.fill_diagonal(gaps, np.inf)
    assert gaps.min() >= 0.2
    assert gaps.min(axis=1).max() < 0.5
    a, b = (np.hypot(*(viewpoints.points - point).T).argmin() for point in ((4.2, 0.8), (5.8, 0.8)))
    around = sum(np.hypot(*(viewpoints.points[k] - (5.0, 4.0))) for k in (a, b))
    # Costs near the wall add to the length.
    assert around < viewpoints.lengths[a, b] < 1.5 * around
    np.testing.assert_array_equal(viewpoints.lengths, viewpoints.lengths.T)
    for origin, last in np.random.default_rng(0).integers(0, len(viewpoints.cells), (50, 2)):
        chain = [last]
        while chain[-1] != origin:
            chain.append(viewpoints.predecessors[origin, chain[-1]])
        steps = [viewpoints.lengths[a, b] for a, b in pairwise(chain)]
        assert sum(steps) <= 1.15 * viewpoints.lengths[origin, last] + 0.2
        assert max(steps, default=0.0) < 1.6


def test_a_viewpoint_that_is_used_up_is_no_stop_again():
    planner = planner_for(corridor(8.0))
    seen, used = seen_from(planner, (8.0, 1.0)), set()
    planner.plan(8.0, 1.0, seen, 2)
    while planner.stops:
        assert not used & set(planner.stops)
        used.add(planner.stops[0])
        planner.use_up(planner.stops[0], seen)
        planner.plan(8.0, 1.0, seen, 2)
    # The map shows nothing new; both ends were missed twice.
    assert 4 <= len(used) <= 20


def test_cells_missed_too_often_are_ignored_and_the_rest_of_the_tour_stays():
    planner = planner_for(corridor(8.0))
    seen = seen_from(planner, (8.0, 1.0))
    assert planner.plan(8.0, 1.0, seen, 20)
    # The map shows nothing of the left end.
    while planner.viewpoints.points[planner.stops[0], 0] < 8.0:
        planner.use_up(planner.stops[0], seen)
        assert planner.plan(4.0, 1.0, seen, 20)
    assert planner.viewpoints.points[planner.stops, 0].min() > 8.0
    assert planner.viewpoints.points[planner.stops, 0].max() > 16.0


def test_a_robot_that_is_walled_in_has_no_tour():
    world = world_of((0, 0), (4, 0), (4, 4), (0, 4))
    planner = planner_for(world)
    assert not planner.plan(30.0, 30.0, np.zeros_like(planner.area.explorable), 2)
    assert planner.stops == []
    walls = planner.area.walls
    walls.data[5:37, 5:37] = 100
    assert find_viewpoints(make_costmap(walls, FOOTPRINT), (1.0, 1.0)) is None
