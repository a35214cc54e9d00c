import math
from dataclasses import replace

import numpy as np
import pytest

from envs.coverage import Coverage, explorable_area, map_iou
from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import load_robot
from envs.slam import Belief
from envs.worlds import Mover, World


def room(width: float, height: float, *extra: tuple[float, float, float, float]) -> World:
    """A rectangular room with its lower left corner at the origin, and further walls."""
    corners = [(0, 0), (width, 0), (width, height), (0, height)]
    walls = [(*corners[i], *corners[(i + 1) % 4]) for i in range(4)]
    return World(
        name="room",
        segments=np.array([*walls, *extra], dtype=np.float64),
        circles=np.empty((0, 3)),
        spawns=(Pose2D(0.5, 0.5, 0.0),),
        bounds=(0.0, 0.0, width, height),
    )


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
    assert not area.can_stand(Pose2D(3.0, 1.0, 0.0))
    # Through a slit too narrow for the robot it sees part of the other half, and all it sees lies within the room.
    slit = room(4.02, 2.02, (2.01, 0.0, 2.01, 0.9), (2.01, 1.05, 2.01, 2.02))
    beyond = explorable_area(slit, burger, 0.05).area - area.area
    assert 0.5 < beyond < 4.0
    assert not explorable_area(slit, burger, 0.05).can_stand(Pose2D(3.0, 1.0, 0.0))


def test_explorable_area_refuses_a_robot_that_does_not_fit(burger):
    with pytest.raises(ValueError, match="does not fit"):
        explorable_area(room(4.0, 4.0, (0.4, 0.4, 0.6, 0.6)), burger, 0.05)


def test_drawn_poses_are_standable_and_vary(burger):
    area = explorable_area(room(2.02, 3.02), burger, 0.05)
    rng = np.random.default_rng(0)
    poses = [area.draw_pose(rng) for _ in range(50)]
    assert all(area.can_stand(pose) for pose in poses)
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


def belief_of(data: np.ndarray, origin: tuple[float, float]) -> Belief:
    known = np.argwhere(data >= 0).astype(np.int32)
    return Belief(Pose2D(0.0, 0.0, 0.0), OccupancyGrid(data, 0.05, origin), known)


@pytest.mark.parametrize("theta", [0.0, 0.3, math.pi / 4, 2.0])
def test_a_perfect_map_covers_everything_however_it_is_turned(burger, theta):
    area = explorable_area(room(2.02, 3.02), burger, 0.05)
    start = Pose2D(1.0, 1.5, theta)
    coverage = Coverage(area, start)
    everything = np.zeros((120, 120), dtype=np.int8)
    gained = coverage.update(belief_of(everything, (-3.0, -3.0)))
    assert gained == pytest.approx(area.area)
    assert coverage.explored_fraction == 1.0
    # Known twice counts once.
    assert coverage.update(belief_of(everything, (-3.0, -3.0))) == 0.0


def test_cells_beyond_the_walls_earn_nothing(burger):
    area = explorable_area(room(2.02, 3.02), burger, 0.05)
    coverage = Coverage(area, Pose2D(1.0, 1.5, 0.0))
    # A map that has drifted by five metres.
    assert coverage.update(belief_of(np.zeros((40, 40), dtype=np.int8), (5.0, 5.0))) == 0.0
    assert coverage.explored_area == 0.0


def test_map_iou_is_one_for_the_truth_and_falls_with_displacement(burger):
    area = explorable_area(room(2.02, 3.02), burger, 0.05)
    start = Pose2D(0.0, 0.0, 0.0)
    assert map_iou(area.walls, area, start) == 1.0
    assert map_iou(area.walls, area, Pose2D(0.05, 0.05, 0.0)) > 0.95
    assert map_iou(area.walls, area, Pose2D(0.4, 0.4, 0.0)) < 0.3
    unknown = OccupancyGrid(np.full((10, 10), -1, dtype=np.int8), 0.05, (0.0, 0.0))
    assert map_iou(unknown, area, start) == 0.0
