import math
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.estimation import NO_CELLS, NO_UPDATE, MapUpdate
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D, Window
from lidarnaut.envs.geometry.raycast import Beams, cast_rays
from lidarnaut.envs.tasks.coverage import Coverage, TrueScan, map_iou, sees
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.worlds import FixedRoute, explorable_area
from tests.rollouts import rollout
from tests.rooms import BURGER, ORIGIN, make_room

ROOM = make_room(0.0, 0.0, 2.02, 3.02, spawn=Pose2D(0.5, 0.5, 0.0))
MIDDLE = Pose2D(1.0, 1.5, 0.0)
LONG = replace(BURGER.lidar, range_max=60.0)
NOTHING_NEW = MapUpdate(NO_CELLS, Window(0, 0, 2, 2))


def test_explorable_area_of_an_empty_room_is_its_floor_if_the_robot_fits():
    area = explorable_area(ROOM, BURGER, 0.05)
    # Cells touched by the walls do not count: one ring of them.
    assert area.area == pytest.approx(2.0 * 3.0, abs=0.3)
    assert not (area.explorable & (area.walls.data > 0)).any()
    with pytest.raises(ValueError, match="does not fit"):
        explorable_area(make_room(0.4, 0.4, 0.6, 0.6, spawn=Pose2D(0.5, 0.5, 0.0)), BURGER, 0.05)


def test_what_cannot_be_reached_or_seen_is_not_explorable():
    closed_off, slit = (
        explorable_area(make_room(0.0, 0.0, 4.02, 2.02, walls, spawn=Pose2D(0.5, 0.5, 0.0)), BURGER, 0.05)
        for walls in ([(2.01, 0.0, 2.01, 2.02)], [(2.01, 0.0, 2.01, 0.9), (2.01, 1.05, 2.01, 2.02)])
    )
    assert closed_off.area == pytest.approx(4.0, abs=0.3)
    # Through a slit too narrow for it, the robot sees a part of the other half, and only area within the room.
    assert 0.5 < slit.area - closed_off.area < 4.0
    for area in (closed_off, slit):
        assert not area.is_traversable(Pose2D(3.0, 1.0, 0.0))


def area_with_mover(radius):
    mover = FixedRoute(radius=radius, waypoints=np.array([[1.0, 1.5], [1.1, 1.5]]), speed=0.1)
    return explorable_area(replace(ROOM, people=(mover,)), BURGER, 0.05)


def test_drawn_poses_are_traversable_clear_of_people_and_equal_those_without_people_elsewhere():
    empty, area = explorable_area(ROOM, BURGER, 0.05), area_with_mover(0.2)
    plain, drawn = ([each.draw_pose(np.random.default_rng(seed)) for seed in range(100)] for each in (empty, area))
    assert all(empty.is_traversable(pose) for pose in plain)
    assert all(BURGER.radius < pose.x < 2.02 - BURGER.radius for pose in plain)
    assert len(set(plain)) == 100
    clear = [math.dist(pose[:2], (1.0, 1.5)) > 0.2 + BURGER.radius for pose in plain]
    assert 0 < sum(clear) < 100
    for pose, other, is_clear in zip(drawn, plain, clear):
        assert math.dist(pose[:2], (1.0, 1.5)) > 0.2 + BURGER.radius
        assert not is_clear or pose == other
    with pytest.raises(ValueError, match="people"):
        area_with_mover(5.0).draw_pose(np.random.default_rng(0))


def true_scan(world, pose, lidar=LONG):
    ranges = np.empty(lidar.num_beams, dtype=np.float32)
    eye = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
    beams = Beams(lidar.angle_min, lidar.angle_increment, lidar.range_max)
    cast_rays(*eye, beams, world.segments, world.circles, ranges)
    return ranges


def update_of(data, origin=(-5.0, -5.0), redrawn=False):
    known = np.argwhere(data >= 0).astype(np.int32)
    return MapUpdate(known, Window(0, 0, *data.shape), redrawn, origin)


EVERYTHING = np.zeros((200, 200), dtype=np.int8)


def begin(world, start=MIDDLE, lidar=LONG):
    """`add` integrates a map update and a perfect scan."""
    area = explorable_area(world, BURGER, 0.05)
    coverage = Coverage(area, start, lidar)
    return area, coverage, lambda update, pose=start: coverage.update(update, 0.05, true_scan(world, pose, lidar), pose)


@pytest.mark.parametrize("theta", [0.0, 0.3, math.pi / 4, 2.0])
def test_a_perfect_map_of_what_was_seen_covers_everything_however_it_is_turned(theta):
    area, coverage, add = begin(ROOM, MIDDLE._replace(theta=theta))
    assert add(NO_UPDATE) == 0.0
    assert add(update_of(EVERYTHING)) == pytest.approx(area.area)
    assert coverage.explored_fraction == 1.0
    assert add(update_of(EVERYTHING)) == 0.0


def test_what_the_map_knows_counts_once_a_true_scan_sees_it():
    # Two halves with a door: little of the right half is visible from the left.
    start = Pose2D(0.5, 1.7, 0.0)
    world = make_room(0.0, 0.0, 4.02, 2.02, [(2.01, 0.5, 2.01, 2.02)], spawn=start)
    area, coverage, add = begin(world, start)
    gained = add(update_of(EVERYTHING))
    assert 0.4 * area.area < gained < 0.8 * area.area
    later = sum(add(NOTHING_NEW, there) for there in (Pose2D(3.5, 1.7, 0.0), Pose2D(2.4, 0.3, 0.0)))
    assert gained + later == pytest.approx(area.area, rel=0.02)
    assert coverage.explored_area == pytest.approx(gained + later)


def test_cells_beyond_the_walls_earn_nothing_and_a_redrawn_map_counts_as_it_is_now():
    area, coverage, add = begin(ROOM)
    assert add(update_of(np.zeros((40, 40), dtype=np.int8), (5.0, 5.0))) == 0.0  # a map with an error of five metres
    assert coverage.explored_area == 0.0
    add(update_of(EVERYTHING))
    half = np.full((200, 200), -1, dtype=np.int8)
    half[:100] = 0
    assert add(update_of(half, redrawn=True)) == pytest.approx(-0.5 * area.area, rel=0.05)
    assert coverage.explored_fraction == pytest.approx(0.5, abs=0.03)
    add(update_of(EVERYTHING, redrawn=True))
    assert coverage.explored_fraction == 1.0


def test_a_lidar_with_a_narrow_view_sees_ahead_only():
    start, narrow = Pose2D(2.0, 2.0, 0.0), replace(LONG, num_beams=90, fov=math.pi / 2)
    _, coverage, add = begin(make_room(0.0, 0.0, 4.02, 4.02, spawn=start), start, narrow)
    add(update_of(EVERYTHING))
    assert coverage.explored_fraction == pytest.approx(0.25, abs=0.08)


@pytest.mark.parametrize(("num_beams", "theta"), [(4, 0.4), (7, 0.0), (36, 0.4), (360, 0.0)])
def test_a_scan_sees_what_lies_within_the_width_of_its_beams(num_beams, theta):
    pose, lidar = Pose2D(3.1, 2.6, theta), replace(LONG, num_beams=num_beams)
    world = make_room(0.0, 0.0, 8.02, 6.02, [(2.0, 2.0, 2.0, 3.5)], spawn=pose)
    area, coverage, add = begin(world, pose, lidar)
    ranges = true_scan(world, pose, lidar)
    coverage.update(update_of(EVERYTHING), 0.05, np.zeros_like(ranges), pose)
    add(NOTHING_NEW)
    # Beams are widened by 10 cm on either side, and lengthened by 10 cm.
    eye = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw + lidar.angle_min))
    x, y = (area.walls.centers(np.argwhere(area.explorable)) - (eye.x, eye.y)).T
    angles = eye.theta + lidar.angle_increment * np.arange(num_beams)
    ahead, aside = (
        np.outer(np.cos(angles + turn), x) + np.outer(np.sin(angles + turn), y) for turn in (0, math.pi / 2)
    )
    swept = ((np.abs(aside) <= 0.1) & (ahead >= 0.0) & (np.hypot(x, y) <= ranges[:, None] + 0.1)).any(axis=0)
    assert coverage.explored_fraction == pytest.approx(swept.mean(), rel=0.06)


def sees_in_python(scan, x, y, tolerance):
    distance = math.sqrt((x - scan.x) ** 2 + (y - scan.y) ** 2)
    if distance > scan.range_max + tolerance or distance <= tolerance:
        return distance <= tolerance
    ratio, num_beams = tolerance / distance, len(scan.ranges)
    bearing = (math.atan2(y - scan.y, x - scan.x) - scan.theta) % (2.0 * math.pi)
    spread = 1.05 * ratio if ratio < 0.5 else math.asin(ratio)
    first, last = (bearing - spread) / scan.increment, (bearing + spread) / scan.increment
    if distance * scan.increment <= 2.0 * tolerance:
        beams = range(math.floor(first), math.ceil(last) + 1)
    else:
        beams = range(math.ceil(first), math.floor(last) + 1)
    turn = num_beams if scan.is_full_turn else round(2.0 * math.pi / scan.increment)
    return any(k % turn < num_beams and float(scan.ranges[k % turn]) + tolerance >= distance for k in beams)


@pytest.mark.parametrize(("num_beams", "fov"), [(1, 6.0), (4, 6.28318), (7, 1.0), (90, 3.14), (360, 6.265), (720, 2.0)])
def test_approximate_bearings_decide_as_exact_ones(num_beams, fov):
    """Many points lie on the borders between beams, and around the first beam."""
    rng, increment = np.random.default_rng(num_beams), fov / num_beams
    ranges = rng.choice([0.5, 2.0, 5.0, np.inf, np.nan], num_beams).astype(np.float32)
    is_full_turn = fov > 2.0 * math.pi - 1.5 * increment
    scan = TrueScan(ranges, 0.3, -0.2, -2.0, increment, is_full_turn, 6.0)
    errors = rng.choice([0.0, 1e-12, -1e-9, 1e-6, -1e-5, 5e-5, 0.01], 800)
    angles = scan.theta + increment * rng.integers(-1, num_beams + 2, 800) + errors
    distances = rng.uniform(0.0, 6.5, 800)
    points = np.stack([scan.x + distances * np.cos(angles), scan.y + distances * np.sin(angles)], axis=1)
    seen = [sees(scan, x, y, 0.1) for x, y in points.tolist()]
    assert seen == [sees_in_python(scan, x, y, 0.1) for x, y in points.tolist()]
    assert 10 < sum(seen) < 790


def test_a_blocked_robot_that_turns_its_wheels_earns_only_what_it_sees():
    blocker = FixedRoute(0.4, np.array([[6.0, 0.5], [6.0, 0.501]]), 0.001)
    corridor = make_room(0.0, 0.0, 32.0, 1.0, people=[blocker], spawn=Pose2D(5.0, 0.5, 0.0))
    env = LidarEnv(Explore, world=corridor, physics="kinematic", slam="odometry", start="spawn", time_limit=200.0)
    out = rollout(env, 0, 1200, lambda _: np.array([1.0, 0.0], dtype=np.float32))
    info = out[-1][4]
    assert len(out) == 1 + 1200
    # The robot stands between 5 m and 5.5 m, and sees 3.5 m back and less than a metre ahead.
    assert info["pose_error"][0] > 0.2
    assert info["explored_fraction"] < 4.9 / 32.0


def test_map_iou_is_one_for_the_true_map_and_falls_with_displacement():
    area = explorable_area(ROOM, BURGER, 0.05)
    assert map_iou(area.walls, area, ORIGIN) == 1.0
    assert map_iou(area.walls, area, Pose2D(0.05, 0.05, 0.0)) > 0.95
    assert map_iou(area.walls, area, Pose2D(0.4, 0.4, 0.0)) < 0.3
    unknown = OccupancyGrid(np.full((10, 10), -1, dtype=np.int8), 0.05, (0.0, 0.0))
    assert map_iou(unknown, area, ORIGIN) == 0.0
