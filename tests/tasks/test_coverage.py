import math
from dataclasses import replace

import numpy as np
import pytest

from envs.core import LidarEnv
from envs.estimation import NO_CELLS, NO_UPDATE, MapUpdate, Window
from envs.geometry import OccupancyGrid, Pose2D
from envs.geometry.raycast import cast_rays
from envs.robots import LidarParams, load_robot
from envs.tasks.coverage import Coverage, map_iou
from envs.tasks.explore import Explore
from envs.worlds import Mover, World, explorable_area
from tests.rollouts import hall


def room(width, height, *walls):
    return hall(width, height, walls)


@pytest.fixture(scope="module")
def burger():
    return load_robot("turtlebot3_burger")


def test_explorable_area_of_an_empty_room_is_its_floor(burger):
    area = explorable_area(room(2.02, 3.02), burger, 0.05)
    # Cells touched by the walls do not count: one ring of them.
    assert area.area == pytest.approx(2.0 * 3.0, abs=0.3)
    assert not (area.explorable & (area.walls.data > 0)).any()


def test_what_cannot_be_reached_or_seen_is_not_explorable(burger):
    closed_off = room(4.02, 2.02, (2.01, 0.0, 2.01, 2.02))
    area = explorable_area(closed_off, burger, 0.05)
    assert area.area == pytest.approx(4.0, abs=0.3)
    assert not area.is_traversable(Pose2D(3.0, 1.0, 0.0))
    # Through a slit too narrow for the robot it sees part of the other half, and all it sees lies within the room.
    slit = room(4.02, 2.02, (2.01, 0.0, 2.01, 0.9), (2.01, 1.05, 2.01, 2.02))
    beyond = explorable_area(slit, burger, 0.05).area - area.area
    assert 0.5 < beyond < 4.0
    assert not explorable_area(slit, burger, 0.05).is_traversable(Pose2D(3.0, 1.0, 0.0))


def test_explorable_area_refuses_a_robot_that_does_not_fit(burger):
    with pytest.raises(ValueError, match="does not fit"):
        explorable_area(room(4.0, 4.0, (0.4, 0.4, 0.6, 0.6)), burger, 0.05)


def test_drawn_poses_are_traversable_and_vary(burger):
    area = explorable_area(room(2.02, 3.02), burger, 0.05)
    rng = np.random.default_rng(0)
    poses = [area.draw_pose(rng) for _ in range(50)]
    assert all(area.is_traversable(pose) for pose in poses)
    assert len(set(poses)) == 50
    assert all(burger.radius < pose.x < 2.02 - burger.radius for pose in poses)


def with_mover(width: float, height: float, x: float, y: float, radius: float) -> World:
    mover = Mover(radius=radius, waypoints=np.array([[x, y], [x + 0.1, y]]), speed=0.1)
    return replace(room(width, height), movers=(mover,))


def test_drawn_poses_are_clear_of_movers_and_equal_those_without_movers_elsewhere(burger):
    area = explorable_area(with_mover(2.02, 3.02, 1.0, 1.5, radius=0.2), burger, 0.05)
    empty = explorable_area(room(2.02, 3.02), burger, 0.05)
    clear = [math.hypot(x - 1.0, y - 1.5) > 0.2 + burger.radius for x, y, _ in map(first_pose(empty), range(100))]
    assert 0 < sum(clear) < 100
    for seed in range(100):
        pose = first_pose(area)(seed)
        assert math.hypot(pose.x - 1.0, pose.y - 1.5) > 0.2 + burger.radius
        assert not clear[seed] or pose == first_pose(empty)(seed)


def first_pose(area):
    return lambda seed: area.draw_pose(np.random.default_rng(seed))


def test_movers_that_cover_everything_are_an_error(burger):
    area = explorable_area(with_mover(2.02, 3.02, 1.0, 1.5, radius=5.0), burger, 0.05)
    with pytest.raises(ValueError, match="movers"):
        area.draw_pose(np.random.default_rng(0))


LONG = replace(load_robot("turtlebot3_burger").lidar, range_max=60.0)


def update_of(data: np.ndarray, origin: tuple[float, float], *, redrawn: bool = False) -> MapUpdate:
    known = np.argwhere(data >= 0).astype(np.int32)
    window = Window(0, 0, data.shape[1] - 1, data.shape[0] - 1)
    return MapUpdate(known, window, redrawn, origin)


def true_scan(world: World, pose: Pose2D, lidar: LidarParams = LONG) -> np.ndarray:
    ranges = np.empty(lidar.num_beams, dtype=np.float32)
    x, y, theta = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
    cast_rays(x, y, theta, lidar.beams, world.segments, world.circles, ranges)
    return ranges


EVERYTHING = np.zeros((200, 200), dtype=np.int8)


@pytest.mark.parametrize("theta", [0.0, 0.3, math.pi / 4, 2.0])
def test_a_perfect_map_of_what_was_seen_covers_everything_however_it_is_turned(burger, theta):
    world, start = room(2.02, 3.02), Pose2D(1.0, 1.5, theta)
    area = explorable_area(world, burger, 0.05)
    coverage = Coverage(area, start, LONG)
    update = update_of(EVERYTHING, (-5.0, -5.0))
    gained = coverage.update(update, 0.05, true_scan(world, start), start)
    assert gained == pytest.approx(area.area)
    assert coverage.explored_fraction == 1.0
    # Known twice counts once.
    assert coverage.update(update, 0.05, true_scan(world, start), start) == 0.0


def test_cells_beyond_the_walls_earn_nothing(burger):
    world, start = room(2.02, 3.02), Pose2D(1.0, 1.5, 0.0)
    coverage = Coverage(explorable_area(world, burger, 0.05), start, LONG)
    # A map that is off by five metres.
    update = update_of(np.zeros((40, 40), dtype=np.int8), (5.0, 5.0))
    assert coverage.update(update, 0.05, true_scan(world, start), start) == 0.0
    assert coverage.explored_area == 0.0


def test_what_the_map_knows_counts_once_a_true_scan_sees_it(burger):
    # Two halves with a door: from the left one little is seen of the right one.
    world = room(4.02, 2.02, (2.01, 0.5, 2.01, 2.02))
    area, start = explorable_area(world, burger, 0.05), Pose2D(0.5, 1.7, 0.0)
    coverage = Coverage(area, start, LONG)
    gained = coverage.update(update_of(EVERYTHING, (-5.0, -5.0)), 0.05, true_scan(world, start), start)
    assert 0.4 * area.area < gained < 0.8 * area.area
    nothing_new, later = MapUpdate(NO_CELLS, Window(0, 0, 1, 1)), 0.0
    for there in (Pose2D(3.5, 1.7, 0.0), Pose2D(2.4, 0.3, 0.0)):
        later += coverage.update(nothing_new, 0.05, true_scan(world, there), there)
    assert gained + later == pytest.approx(area.area, rel=0.02)
    assert coverage.explored_area == pytest.approx(gained + later)


def test_scans_that_were_not_integrated_change_nothing(burger):
    world, start = room(2.02, 3.02), Pose2D(1.0, 1.5, 0.0)
    coverage = Coverage(explorable_area(world, burger, 0.05), start, LONG)
    assert coverage.update(NO_UPDATE, 0.05, true_scan(world, start), start) == 0.0


def test_a_redrawn_map_counts_as_it_is_now(burger):
    world, start = room(2.02, 3.02), Pose2D(1.0, 1.5, 0.0)
    area = explorable_area(world, burger, 0.05)
    coverage, scan = Coverage(area, start, LONG), true_scan(world, start)
    coverage.update(update_of(EVERYTHING, (-5.0, -5.0)), 0.05, scan, start)
    half = np.full((200, 200), -1, dtype=np.int8)
    half[:100] = 0
    lost = coverage.update(update_of(half, (-5.0, -5.0), redrawn=True), 0.05, scan, start)
    assert lost == pytest.approx(-0.5 * area.area, rel=0.05)
    assert coverage.explored_fraction == pytest.approx(0.5, abs=0.03)
    coverage.update(update_of(EVERYTHING, (-5.0, -5.0), redrawn=True), 0.05, scan, start)
    assert coverage.explored_fraction == 1.0


def test_a_lidar_with_a_narrow_view_sees_ahead_only(burger):
    world, start = room(4.02, 4.02), Pose2D(2.0, 2.0, 0.0)
    narrow = replace(LONG, num_beams=90, fov=math.pi / 2)
    coverage = Coverage(explorable_area(world, burger, 0.05), start, narrow)
    coverage.update(update_of(EVERYTHING, (-5.0, -5.0)), 0.05, true_scan(world, start, narrow), start)
    assert coverage.explored_fraction == pytest.approx(0.25, abs=0.08)


@pytest.mark.parametrize("num_beams", [4, 7, 36, 360])
@pytest.mark.parametrize("theta", [0.0, 0.4])
def test_a_scan_sees_what_lies_within_the_width_of_its_beams(burger, num_beams, theta):
    world, pose, lidar = (
        room(8.02, 6.02, (2.0, 2.0, 2.0, 3.5)),
        Pose2D(3.1, 2.6, theta),
        replace(LONG, num_beams=num_beams),
    )
    area, ranges = explorable_area(world, burger, 0.05), true_scan(world, pose, lidar)
    coverage = Coverage(area, pose, lidar)
    coverage.update(update_of(EVERYTHING, (-5.0, -5.0)), 0.05, np.zeros_like(ranges), pose)
    coverage.update(MapUpdate(NO_CELLS, Window(0, 0, 1, 1)), 0.05, ranges, pose)
    # Swept by beams that are 10 cm wide on either side, and that much longer.
    eye = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw + lidar.angle_min))
    x, y = (area.walls.centers(np.argwhere(area.explorable)) - (eye.x, eye.y)).T
    angles = eye.theta + lidar.angle_increment * np.arange(num_beams)
    ahead, aside = (
        np.outer(np.cos(angles + turn), x) + np.outer(np.sin(angles + turn), y) for turn in (0, math.pi / 2)
    )
    swept = ((np.abs(aside) <= 0.1) & (ahead >= 0.0) & (np.hypot(x, y) <= ranges[:, None] + 0.1)).any(axis=0)
    assert coverage.explored_fraction == pytest.approx(swept.mean(), rel=0.06)


@pytest.mark.parametrize("slam", ["truth", "tinyslam", "odometry"])
def test_under_ground_truth_all_that_is_mapped_counts(slam):
    env = LidarEnv(Explore, world="rooms", world_size=(8.0, 8.0), physics="kinematic", slam=slam, start="random")
    rng = np.random.default_rng(0)
    env.reset(seed=1)
    for _ in range(40):
        action = rng.uniform((0.0, -1.0), 1.0).astype(np.float32)
        for _ in range(8):
            env.step(action)
    grid, area = env.belief.grid, env.task.coverage.area
    mapped = np.zeros_like(area.explorable)
    lattice = [
        grid.centers(np.argwhere(grid.data >= 0) + offset - 0.5)
        for offset in ((0.25, 0.25), (0.25, 0.75), (0.75, 0.25), (0.75, 0.75))
    ]
    cells = area.walls.cells(env.map_pose.transform(np.concatenate(lattice)))
    cells = cells[area.walls.contains(cells)]
    mapped[tuple(cells.T)] = True
    mapped &= area.explorable
    explored = env.task.coverage.explored
    assert not (explored & ~mapped).any()
    if slam == "truth":
        np.testing.assert_array_equal(explored, mapped)


@pytest.mark.parametrize("slam", ["tinyslam", "odometry"])
def test_a_blocked_robot_that_turns_its_wheels_earns_only_what_it_sees(slam):
    blocker = Mover(0.4, np.array([[6.0, 0.5], [6.0, 0.501]]), 0.001)
    corridor = replace(hall(32.0, 1.0), spawns=(Pose2D(5.0, 0.5, 0.0),), movers=(blocker,))
    env = LidarEnv(Explore, world=corridor, physics="kinematic", slam=slam, start="spawn", time_limit=200.0)
    env.reset(seed=0)
    for _ in range(1200):
        _, _, terminated, _, info = env.step(np.array([1.0, 0.0], dtype=np.float32))
        assert not terminated
    # It stands between 5 m and 5.5 m, and sees 3.5 m back and less than a metre ahead.
    assert info["pose_error"][0] > 0.5
    assert info["explored_fraction"] < 4.9 / 32.0


def test_map_iou_is_one_for_the_true_map_and_falls_with_displacement(burger):
    area = explorable_area(room(2.02, 3.02), burger, 0.05)
    start = Pose2D(0.0, 0.0, 0.0)
    assert map_iou(area.walls, area, start) == 1.0
    assert map_iou(area.walls, area, Pose2D(0.05, 0.05, 0.0)) > 0.95
    assert map_iou(area.walls, area, Pose2D(0.4, 0.4, 0.0)) < 0.3
    unknown = OccupancyGrid(np.full((10, 10), -1, dtype=np.int8), 0.05, (0.0, 0.0))
    assert map_iou(unknown, area, start) == 0.0
