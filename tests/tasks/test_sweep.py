import itertools
import math

import numpy as np
import pytest
from scipy import ndimage

from lidarnaut.baselines import policies_for
from lidarnaut.baselines.sweeping import boustrophedon, spiral
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.tasks.coverage import Frame
from lidarnaut.envs.tasks.sweep import Sweep, sweep
from tests.rollouts import play
from tests.rooms import make_room

AHEAD = np.array([1.0, 0.0], dtype=np.float32)
ROOM = make_room(0.0, 0.0, 3.02, 3.02, spawn=Pose2D(0.5, 0.5, 0.0))
SMALL = make_room(0.0, 0.0, 1.0, 1.0, spawn=Pose2D(0.5, 0.5, 0.0))
CORRIDOR = make_room(0.0, 0.0, 3.0, 0.6, spawn=Pose2D(0.5, 0.3, 0.0))
SETTINGS = {"world": ROOM, "robot": "turtlebot3_burger", "physics": "kinematic", "localizer": "truth", "start": "spawn"}


@pytest.mark.parametrize(
    "line", [(0.5, 0.5, 0.5, 0.5), (0.2, 0.3, 0.9, 0.6), (0.9, 0.9, 1.2, -0.3), (5.0, 5.0, 6.0, 6.0)]
)
def test_the_kernel_clears_cells_near_the_line_as_a_slow_reference_does(line):
    frame, mask = Frame(-0.1, 0.05, 0.05), np.ones((20, 24), dtype=bool)
    rows, cols = np.nonzero(mask)
    points = np.column_stack([frame.x + (cols + 0.5) * frame.resolution, frame.y + (rows + 0.5) * frame.resolution])
    ends = np.array(line).reshape(2, 2)
    along = np.linspace(ends[0], ends[1], 2001)
    away = np.sqrt(((points[:, None] - along) ** 2).sum(axis=2)).min(axis=1).reshape(mask.shape)
    count = sweep(mask, frame, np.array([line]), 0.163)
    np.testing.assert_array_equal(mask, away > 0.163)
    assert count == (~mask).sum()
    assert sweep(mask, frame, np.array([line]), 0.163) == 0


def test_a_straight_drive_sweeps_a_strip_of_the_robots_width():
    env = LidarEnv(Sweep, **SETTINGS, map_resolution=0.02)
    _, info = env.reset(seed=0)
    radius = env.robot_params.radius
    assert info["swept_area"] == pytest.approx(math.pi * radius**2, rel=0.1)
    # All of the room, without the corners and the cells at the walls.
    assert env.task.floor_area == pytest.approx(9.0, abs=0.2)
    assert info["swept_fraction"] == pytest.approx(info["swept_area"] / env.task.floor_area)
    for _ in range(60):
        before, (_, _, _, _, info) = info, env.step(AHEAD)
        assert info["rewards"]["swept"] == pytest.approx(info["swept_area"] - before["swept_area"])
    strip = math.pi * radius**2 + 2.0 * radius * info["path_length"]
    assert info["swept_area"] == pytest.approx(strip, rel=0.05)


@pytest.mark.parametrize(
    ("world", "robot", "name"),
    [
        (ROOM, "turtlebot3_burger", "boustrophedon"),
        (ROOM, "turtlebot3_burger", "spiral"),
        ("pimouse_arena", "raspimouse", "spiral"),  # inaccurate poses
        (SMALL, "create3", "spiral"),
        (CORRIDOR, "create3", "boustrophedon"),
    ],
)
def test_classic_policies_sweep_until_the_target(world, robot, name):
    env = LidarEnv(Sweep, world=world, robot=robot, physics="kinematic", start="spawn")
    episode = play(env, name)
    assert episode.end_reason == "swept"
    assert set(policies_for(env)) == {"boustrophedon", "spiral", "bounce", "random", "wall_follower"}
    if world is SMALL or world is CORRIDOR:
        assert (episode.collisions, episode.duration < 80.0) == (0, True)
    if world is ROOM:
        assert episode.collisions == 0
        # At most 1.8 times the length of lanes without overlap.
        assert episode.path_length < 1.8 * env.task.floor_area / (2.0 * env.robot_params.radius)


def test_a_policy_goes_on_until_the_time_limit_if_floor_is_left(monkeypatch):
    small = make_room(0.0, 0.0, 0.6, 0.6, spawn=Pose2D(0.3, 0.3, 0.0))
    env = LidarEnv(Sweep, **SETTINGS | {"world": small, "robot": "create3"}, target_swept=1.0, time_limit=40.0)
    episode = play(env, "boustrophedon")
    assert (episode.end_reason, episode.collisions) == ("time_limit", 0)
    assert episode.swept_fraction > 0.6
    env.time_limit = 400.0
    monkeypatch.setattr("lidarnaut.baselines.sweeping.MAX_PASSES", 2)
    assert play(env, "boustrophedon").end_reason == "no_floor_left"


@pytest.mark.parametrize("world", [SMALL, CORRIDOR, make_room(0.0, 0.0, 0.6, 0.6, spawn=Pose2D(0.3, 0.3, 0.0))])
def test_the_body_reaches_all_floor_with_half_a_cell_of_clearance_to_the_true_walls(world):
    env = LidarEnv(Sweep, **SETTINGS | {"world": world, "robot": "create3"})
    env.reset(seed=0)
    walls, radius, floor = env.task.area.walls, env.robot_params.radius, env.task.unswept.copy()
    least = radius + 0.5 * walls.resolution - 1e-6
    x0, y0, x1, y1 = world.bounds
    for x, y in walls.centers(np.argwhere(env.task.area.traversable)):
        if min(x - x0, x1 - x, y - y0, y1 - y) >= least:
            sweep(floor, Frame(*walls.origin, walls.resolution), np.array([[x, y, x, y]]), radius)
    assert env.task.unswept.any()
    assert not floor.any()


def test_a_robot_that_covers_a_tiny_cell_ends_at_once():
    cell = make_room(0.0, 0.0, 0.45, 0.45, spawn=Pose2D(0.225, 0.225, 0.0))
    episode = play(LidarEnv(Sweep, **SETTINGS | {"world": cell, "robot": "create3"}), "spiral")
    assert (episode.end_reason, round(episode.duration, 1)) == ("swept", 0.1)


def test_a_lost_robot_is_localized_before_the_plan():
    settings = {"world": "turtlebot3_world", "robot": "turtlebot3_burger", "initial_pose": "unknown"}
    env = LidarEnv(Sweep, **settings, physics="kinematic", time_limit=150.0)
    _, info = env.reset(seed=0)
    assert info["is_lost"]
    episode = play(env, "boustrophedon")
    assert (episode.end_reason, episode.history.final["is_lost"]) == ("time_limit", False)
    assert episode.swept_fraction > 0.1


def test_bounces_sweep_more_than_random_commands():
    env, swept = LidarEnv(Sweep, **SETTINGS, time_limit=60.0), {}
    for name in ("bounce", "random"):
        swept[name] = play(env, name).swept_fraction
    assert swept["bounce"] > 1.5 * swept["random"]


def covered(tours, shape, width):
    """Return the cells within half a lane of the tours' lines."""
    mask = np.zeros(shape, dtype=bool)
    for patch in tours:
        for a, b in itertools.pairwise(patch[0]):
            cells = a + np.linspace(0.0, 1.0, 200)[:, None] * (b - a)
            mask[tuple(np.round(cells).astype(int).T)] = True
    return ndimage.maximum_filter(mask, width // 2 * 2 + 1)


FREE = np.ones((48, 60), dtype=bool)
PILLAR = FREE.copy()
PILLAR[18:30, 24:36] = False


@pytest.mark.parametrize(
    ("plan", "free", "least"),
    [(boustrophedon, FREE, 1.0), (boustrophedon, PILLAR, 1.0), (spiral, FREE, 0.9), (spiral, PILLAR, 0.85)],
)
def test_tours_cover_the_free_cells(plan, free, least):
    tours = plan(free, 6, (3, 3))
    assert covered(tours, free.shape, 6)[free].mean() >= least
    for patch in tours:
        for tour in patch:
            assert free[tuple(tour.T)].all()


def test_a_pillar_splits_the_floor_into_four_cells_and_a_bend_into_two():
    patches = boustrophedon(PILLAR, 6, (0, 0))
    assert sorted(patch[0][:, 1].min() for patch in patches) == [0, 0, 0, 36]
    for patch in patches:  # four tours, from each corner
        assert len({tuple(tour[0]) for tour in patch}) == 4
    left = next(patch[0] for patch in patches if patch[0][:, 1].max() == 23 and patch[0][:, 0].min() == 18)
    assert abs(np.diff(left[:2, 1])).item() == 23  # along the longer axis
    bend = np.zeros((48, 60), dtype=bool)
    bend[:14] = bend[:, :14] = True
    # Four lanes along each arm, of 60 and 34 cells.
    for patch, length in zip(boustrophedon(bend, 6, (0, 0)), (60, 34), strict=True):
        assert np.abs(np.diff(patch[0], axis=0)).sum(axis=1)[::2].tolist() == [length - 1] * 4


def test_a_spiral_is_a_closed_tour_with_one_visit_per_lane_cell():
    ((tour,),) = spiral(FREE, 6, (3, 3))
    assert tuple(tour[0]) == tuple(tour[-1])
    lengths = np.abs(np.diff(tour, axis=0)).sum(axis=1)
    assert (np.abs(np.diff(tour, axis=0)).min(axis=1) == 0).all()
    # 4 x 5 blocks of 2 x 2 lane cells, each 6 cells wide.
    assert lengths.sum() == 6 * 4 * 4 * 5
