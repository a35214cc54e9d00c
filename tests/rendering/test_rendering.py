import dataclasses
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lidarnaut.envs.geometry import FREE, OCCUPIED, OccupancyGrid, Pose2D
from lidarnaut.envs.navigation import Markers
from lidarnaut.envs.rendering import Renderer, Scene, style
from lidarnaut.envs.rendering.panels import beam_ends
from lidarnaut.envs.rendering.view import View
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.slam import Belief, PoseGraphView
from lidarnaut.envs.slam.posegraph import PoseGraph
from lidarnaut.envs.worlds import FixedRoute
from tests.rooms import BURGER, make_room

PERSON = FixedRoute(0.3, np.array([(4.0, 5.0), (7.0, 5.0)]), 1.0)
WORLD = make_room(0.0, 0.0, 8.0, 6.0, circles=[(6.0, 4.5, 0.5)], people=[PERSON], spawn=Pose2D(1.0, 1.0, 0.0))
ROOT = Path(__file__).parents[2]
START = Pose2D(2.0, 1.0, 0.5)
"""Start pose; the map frame is rotated against the world, to detect a missing transform."""


TRUE, ESTIMATED = Pose2D(5.0, 2.0, 1.0), Pose2D(4.2, 2.6, 1.3)


def make_scene(pose=TRUE, estimated=ESTIMATED):
    """Free and known for x < 6 in the world, occupied for x = 6 to 6.5, unknown elsewhere."""
    grid = OccupancyGrid(np.full((300, 300), -1, dtype=np.int8), 0.05, (-7.5, -7.5))
    cells = np.argwhere(grid.data < 0)
    x = START.transform(grid.centers(cells))[:, 0]
    grid.data[tuple(cells[(x > 1.0) & (x < 6.0)].T)] = FREE
    grid.data[tuple(cells[(x >= 6.0) & (x < 6.5)].T)] = OCCUPIED
    estimated = START.between(estimated)
    ranges = np.full(BURGER.lidar.num_beams, np.inf, dtype=np.float32)
    ranges[::7], ranges[1::7] = 1.2, np.nan
    return Scene(
        world=WORLD,
        robot=BURGER,
        pose=pose,
        start=START,
        belief=Belief(estimated, grid, np.empty((0, 2), dtype=np.int32)),
        ranges=ranges,
        trail=np.array([START[:2], pose[:2]]),
        estimated_trail=np.array([(0.0, 0.0), estimated[:2]]),
        plan=np.array([estimated[:2], START.between(Pose2D(2.0, 4.0, 0.0))[:2]]),
        progress=0.5,
        time=75.0,
        collisions=3,
        people=np.array([[5.5, 5.0, 0.3, 0.0, 0.0]]),
        tracks=np.empty((0, 5)),
    )


@pytest.fixture(scope="module")
def renderer():
    return Renderer("rgb_array", 10)


def panels(frame):
    return frame[108:680, 16:632], frame[108:680, 648:1264]


def found(panel, colour, tolerance=12):
    """Return positions of a colour in a panel, world frame, shape (n, 2) [m]."""
    close = np.abs(panel.astype(int) - colour).max(axis=2) <= tolerance
    rows, columns = np.nonzero(close)
    height, width = panel.shape[:2]
    view = View(WORLD.bounds, (width, height))
    corner = view.pixels(np.array([(0.0, 0.0)]))[0]
    return (np.column_stack([columns, rows]) + 0.5 - corner) / (view.scale, -view.scale)


def test_rgb_arrays_are_fresh_and_equal_for_equal_scenes(renderer):
    first, second, other = (each.draw(make_scene()) for each in (renderer, renderer, Renderer("rgb_array", 10)))
    assert (first.shape, first.dtype, first.flags.writeable) == ((720, 1280, 3), np.uint8, True)
    assert not np.shares_memory(first, second)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(first, other)


def test_robots_map_floor_and_bodies_are_where_they_should_be(renderer):
    truth, belief = panels(renderer.draw(make_scene()))
    true = ((panel, style.TRUE, TRUE) for panel in (truth, belief))
    for panel, colour, pose in (*true, (belief, style.ESTIMATED, ESTIMATED)):
        positions = found(panel, colour)
        near = np.hypot(*(positions - pose[:2]).T) < 0.25
        assert near.sum() > 40
        assert np.abs(positions[near].mean(axis=0) - pose[:2]).max() < 0.08
    assert len(found(truth, style.ESTIMATED)) == 0
    occupied, frontier = found(belief, style.OCCUPIED)[:, 0], found(belief, style.FRONTIER)[:, 0]
    assert (occupied.min(), occupied.max()) == pytest.approx((6.0, 6.5), abs=0.1)
    assert len(frontier) > 100
    assert np.abs(frontier - 1.0).max() < 0.2
    assert found(belief, style.UNKNOWN)[:, 0].min() < 0.0
    assert np.hypot(*(found(belief, style.PLAN) - (2.0, 4.0)).T).min() < 0.05
    floor, outside, solid = (found(truth, colour, 2) for colour in (style.FLOOR, style.OUTSIDE, style.SOLID))
    assert floor.min() > -0.05
    assert (floor.max(axis=0) < (8.05, 6.05)).all()
    assert ((outside < 0) | (outside > (8.0, 6.0))).any(axis=1).all()
    assert np.hypot(*(solid - (6.0, 4.5)).T).max() < 0.5
    assert np.abs(found(truth, style.PERSON).mean(axis=0) - (5.5, 5.0)).max() < 0.05


def test_beams_end_where_the_scan_says():
    scene = make_scene(pose=Pose2D(5.0, 2.0, 0.0))
    sensor, ends = beam_ends(scene.robot, scene.pose, scene.ranges)
    mount = BURGER.lidar.mount
    np.testing.assert_allclose(sensor, (5.0 + mount.x, 2.0 + mount.y))
    lengths = np.hypot(*(ends - sensor).T)
    np.testing.assert_allclose(lengths[:3], [1.2, 0.0, BURGER.lidar.range_max], rtol=1e-6)
    first = math.atan2(*(ends[0] - sensor)[::-1])
    assert first == pytest.approx(math.remainder(BURGER.lidar.angle_min, 2 * math.pi))


@pytest.mark.parametrize("robot", ["tugbot", "raspimouse", "turtlebot3_waffle_pi"])
def test_every_robot_is_visible_in_a_large_world(renderer, robot):
    large = dataclasses.replace(WORLD, name="a hall", segments=WORLD.segments * 10, bounds=(0.0, 0.0, 80.0, 60.0))
    robot = load_robot(robot)
    ranges = np.full(robot.lidar.num_beams, np.nan, dtype=np.float32)
    scene = dataclasses.replace(make_scene(), world=large, robot=robot, ranges=ranges, trail=np.empty((0, 2)))
    truth, _ = panels(renderer.draw(scene))
    assert len(found(truth, style.TRUE)) > 60


def test_painted_grid_equals_looking_up_every_pixel():
    rng = np.random.default_rng(0)
    grid = OccupancyGrid(rng.integers(-1, 101, (40, 30)).astype(np.int8), 0.1, (-1.0, -2.0))
    view, image = View((0.0, 0.0, 4.0, 3.0), (64, 48)), np.zeros((48, 64), dtype=np.uint32)
    palette = rng.permutation(102).astype(np.uint32)
    view.paint_grid(grid, START, palette, image)
    expected = np.zeros_like(image)
    corner = view.pixels(np.array([(0.0, 0.0)]))[0]
    for i, j in np.ndindex(48, 64):
        x, y = (j + 0.5 - corner[0]) / view.scale, -(i + 0.5 - corner[1]) / view.scale
        cell = grid.cells(START.inverse().transform(np.array([(x, y)])))[0]
        expected[i, j] = palette[grid.data[tuple(cell)] + 1 if grid.contains(cell) else 0]
    assert len(np.unique(expected)) > 50
    np.testing.assert_array_equal(image, expected)


def test_human_draws_into_a_window_and_keeps_pace_and_wrong_arguments_are_named():
    import pygame

    renderer = Renderer("human", 20)
    assert renderer.draw(make_scene()) is None
    began = pygame.time.get_ticks()
    for _ in range(4):
        renderer.draw(make_scene())
    assert pygame.time.get_ticks() - began >= 4 * 50 - 10
    other = Renderer("human", 1000)
    other.draw(make_scene())
    renderer.close()
    renderer.close()
    assert other.draw(make_scene()) is None, "closing one window leaves the others open"
    other.close()


def test_arrays_need_no_display_and_import_needs_no_pygame():
    code = """
import os, sys
import lidarnaut.envs.rendering
assert "pygame" not in sys.modules
from tests.rendering.test_rendering import Renderer, make_scene
assert Renderer("rgb_array", 10).draw(make_scene()).any()
import pygame
assert not pygame.display.get_init()
assert "SDL_VIDEODRIVER" not in os.environ
try:
    Renderer("human", 10).draw(make_scene())
except RuntimeError as error:
    print(error)
"""
    hidden = {"SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"}
    environment = {key: value for key, value in os.environ.items() if key not in hidden}
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=ROOT)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("cannot open a window"), "and nothing else, such as pygame's greeting"
    assert "SDL_VIDEODRIVER=dummy" in result.stdout


def test_nodes_and_loop_closures_are_drawn_where_there_are_any(renderer):
    scene = make_scene(START, Pose2D(0.0, 0.0, 0.0))
    plain = renderer.draw(scene)
    graph = PoseGraph()
    graph.add_submap((0.0, 0.0, 0.0))
    graph.add_node((1.5, 0.5, 0.0))
    graph.add_constraint(0, 0, (1.5, 0.5, 0.0), np.eye(3), is_loop=True)
    scene.pose_graph = PoseGraphView(graph.arrays)
    drawn = renderer.draw(scene)
    left, right = np.array_split(np.any(drawn != plain, axis=2)[108:], 2, axis=1)
    assert not left.any()
    assert right.sum() > 50
    assert (np.abs(drawn[108:].astype(int) - style.LOOP).max(axis=2) < 60).any()


def in_map_frame(*points):
    return START.inverse().transform(np.array(points, dtype=float))


TREES = Markers(
    clusters=in_map_frame((3.0, 5.0)),
    chosen=in_map_frame((5.5, 5.2)),
    points=in_map_frame((1.5, 0.5)),
    trees=[in_map_frame((2.5, 1.0), (2.5, 5.5))[None], in_map_frame((4.8, 3.5), (5.6, 3.5))[None], np.empty((0, 2, 2))],
)
FLOOR = Markers(
    predicted=np.column_stack([in_map_frame((3.0, 5.0), (3.0, 2.0)), [1.0, 0.5]]),
    side=0.4,
    tour=in_map_frame((4.0, 1.0), (4.0, 4.0)),
)
MIXED = tuple(round(0.5 * (a + b)) for a, b in zip(style.PREDICTED, style.FREE, strict=True))


@pytest.mark.parametrize(
    ("markers", "places"),
    [
        (TREES, {style.GLOBAL_TREE: [(2.5, 1.0), (2.5, 3.0), (2.5, 5.5)], style.LOCAL_TREE: [(1.5, 0.5), (5.2, 3.5)]}),
        (TREES, {style.FRONTIER: [(3.2, 5.0)], style.PLAN: [(5.5, 5.2)]}),
        (
            FLOOR,
            {style.PREDICTED: [(3.0, 5.0), (3.0, 5.15)], MIXED: [(3.0, 2.0)], style.TOUR: [(4.0, 1.0), (4.0, 4.0)]},
        ),
    ],
)
def test_markers_are_drawn_where_they_are(renderer, markers, places):
    scene = make_scene()
    plain = renderer.draw(scene)
    scene.markers = markers
    drawn = renderer.draw(scene)
    (truth, before), (same, after) = panels(plain), panels(drawn)
    np.testing.assert_array_equal(truth, same)
    for colour, points in places.items():
        for point in points:
            gaps = (np.hypot(*(found(panel, colour) - point).T).min(initial=9.0) for panel in (before, after))
            assert next(gaps) > 0.3
            assert next(gaps) < 0.15
    legend = np.any(drawn != plain, axis=2)[80:104, 648:1264]
    assert legend.any(axis=0).sum() > 200
    scene.pose_graph = PoseGraphView(PoseGraph().arrays)  # a second row
    both = np.any(renderer.draw(scene) != drawn, axis=2)[64:88, 648:1264]
    assert both.any(axis=0).sum() > 80


def test_tested_poses_are_magnified_and_coloured_by_their_cost(renderer):
    scene, rng = make_scene(), np.random.default_rng(0)
    away = rng.uniform(-0.01, 0.01, (400, 2))
    around = START.between(ESTIMATED)
    costs = np.hypot(*away.T) * 1000
    scene.tested = np.column_stack([away + around[:2], np.full(400, around.theta), costs])
    inset = renderer.draw(scene)[116:276, 656:816]
    cells = [np.argwhere(np.abs(inset.astype(int) - colour).max(axis=2) < 5) for colour in style.COSTS]
    gaps = [np.hypot(*(own - 80).T).mean() for own in cells]
    assert gaps == sorted(gaps)
    assert 15 < gaps[0] < gaps[-1] - 20
    for count in (1, 0):  # a single pose; none since the first scan
        scene.tested = scene.tested[:count]
        drawn = renderer.draw(scene)[116:276, 656:816]
        assert (drawn == style.COSTS[0]).all(axis=2).any() == (count > 0)


def test_points_of_a_view_are_those_of_their_pixels():
    view, points = View(WORLD.bounds, (616, 572)), np.array([(1.0, 2.0), (-3.0, 4.0)])
    np.testing.assert_allclose(view.points(view.pixels(points)), points)
