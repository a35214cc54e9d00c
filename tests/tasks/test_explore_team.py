import math
from dataclasses import replace

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence as same

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.observations.positions import PEERS_RANGE
from lidarnaut.envs.simulation.contact import check_starts
from lidarnaut.envs.tasks.explore import Explore, ExploreTeam
from lidarnaut.envs.tasks.starts import draw_starts
from lidarnaut.envs.worlds import FixedRoute, explorable_area
from tests.rooms import BURGER, hall
from tests.test_core import QUICK


def team_in(world, start, **arguments):
    arguments = {"physics": "kinematic", "num_robots": len(start), **arguments}
    env = LidarEnv(ExploreTeam, world=world, start=start, **arguments)
    return env, *env.reset(seed=0)


@pytest.mark.parametrize(
    ("slam", "physics"),
    [("tinyslam", "kinematic"), ("odometry", "kinematic"), ("truth", "kinematic"), ("tinyslam", "bullet")],
)
def test_a_team_of_one_equals_a_single_robot_to_the_bit(slam, physics):
    kwargs = {**QUICK, "slam": slam, "physics": physics}
    env, team = LidarEnv(Explore, **kwargs), LidarEnv(ExploreTeam, **kwargs, num_robots=1)
    rng = np.random.default_rng(0)
    (observation, info), (stacked, team_info) = env.reset(seed=5), team.reset(seed=5)
    for _ in range(120):
        assert same({key: part[None] for key, part in observation.items()}, stacked)
        for key, value in info.items():
            theirs = team_info[key][0] if key in ("pose_error", "path_length", "collisions") else team_info[key]
            assert np.array_equal(value, theirs)
        action = rng.uniform(-0.5, 1.0, 2).astype(np.float32)
        observation, reward, *ends, info = env.step(action)
        stacked, team_reward, *team_ends, team_info = team.step(action[None])
        assert (reward, ends) == (team_reward, team_ends)
        assert env.belief.pose == team.robots[0].belief.pose
    np.testing.assert_array_equal(env.robots[0].estimator.map.words, team.robots[0].estimator.map.words)
    np.testing.assert_array_equal(env.belief.grid.data, team.robots[0].belief.grid.data)


def test_robots_start_near_each_other_in_sight_and_with_known_relative_poses():
    env = LidarEnv(ExploreTeam, **{**QUICK, "world_size": (10.0, 10.0)}, num_robots=4)
    for seed in range(3):
        env.reset(seed=seed)
        poses = [truth.state.pose for truth in env.truths]
        assert env.map_pose == poses[0]
        for k, pose in enumerate(poses):
            estimated = env.map_pose.compose([robot.belief for robot in env.robots][k].pose)
            np.testing.assert_allclose(estimated, pose, atol=1e-9)
            for other in poses[:k]:
                assert 2 * BURGER.radius + 0.2 <= math.dist(pose[:2], other[:2])
            assert math.dist(pose[:2], poses[0][:2]) <= 2.0


def test_starts_can_be_chosen_but_not_in_each_other_and_not_for_more_robots_than_fit():
    poses = ((1.0, 1.0, 0.5), (2.0, 1.0, -0.5))
    for start in (poses, np.array(poses)):
        env, *_ = team_in(hall(), start)
        assert tuple(tuple(truth.state.pose) for truth in env.truths) == poses
    with pytest.raises(ValueError, match="robots 0 and 1"):
        team_in(hall(), ((1.0, 1.0, 0.0), (1.2, 1.0, 0.0)))
    closet = replace(hall(0.5, 0.5), spawns=(Pose2D(0.25, 0.25, 0.0),))
    env = LidarEnv(ExploreTeam, world=closet, physics="kinematic", num_robots=4, start="spawn")
    with pytest.raises(ValueError, match="num_robots = 4"):
        env.reset(seed=0)


@pytest.mark.parametrize("seed", range(5))
def test_robots_start_close_together_or_out_of_sight_only_where_there_is_no_room(seed):
    # A corridor around a corner; robots start behind each other.
    corridor = hall(4.0, 0.7, [[0.4, 0.0, 0.4, 0.3], [0.4, 0.3, 4.0, 0.3]])
    corridor = replace(corridor, spawns=(Pose2D(0.225, 0.175, 0.0),))
    area, first = explorable_area(corridor, BURGER, 0.05), corridor.spawns[0]

    def starts(num_robots):
        return draw_starts(area, corridor, BURGER, first, num_robots, np.random.default_rng(seed))

    def hidden(poses):
        # Past the corner, and out of sight from before it.
        return sum(pose.x > 0.7 for pose in poses)

    assert hidden(starts(2)) == 0
    assert hidden(starts(4)) > 0
    check_starts(starts(4), BURGER.radius, corridor)


def test_peers_are_seen_and_shown_by_position_and_heading_which_saturate():
    _, observation, _ = team_in(hall(), ((1.0, 2.0, 0.0), (3.0, 2.0, math.pi)))
    seen = observation["scan"][:, np.argmin(np.abs(BURGER.lidar.angles))] * BURGER.lidar.range_max
    assert seen == pytest.approx([2.0 - BURGER.radius - BURGER.lidar.mount.x] * 2, abs=0.05)
    np.testing.assert_allclose(observation["teammates"], [[2 / PEERS_RANGE, 0, -1, 0]] * 2, atol=1e-6)
    start = ((1.0, 1.0, math.pi / 2), (1.0, 3.5, 0.0), (39.0, 1.0, math.pi / 2))
    _, observation, _ = team_in(hall(40.0), start, slam="truth")
    np.testing.assert_allclose(observation["teammates"][0], [2.5 / PEERS_RANGE, 0, 0, -1, 0, -1, 1, 0], atol=1e-6)


@pytest.mark.parametrize("slam", ["truth", "tinyslam"])
def test_peers_leave_no_trace_in_the_map(slam):
    start = ((1.0, 2.0, 0.0), (2.5, 2.0, math.pi / 2), (2.0, 3.2, 0.0))
    env, *_ = team_in(hall(), start, slam=slam, target_coverage=1.0)
    grid, highest = env.robots[0].belief.grid, 0
    for _ in range(150):
        backwards = env.robots[1].reading.bumper
        env.step(np.array([[0.3, 0.5], [-1.0, 0.5] if backwards else [0.8, 0.1], [0.0, 0.3]], dtype=np.float32))
        x, y = env.map_pose.transform(grid.centers(np.argwhere(grid.data >= 0))).T
        inner = (x > 0.4) & (x < 7.6) & (y > 0.4) & (y < 3.6)
        highest = max(highest, grid.data[grid.data >= 0][inner].max())
    assert (grid.data >= 65).sum() > 200
    assert env.info({})["pose_error"][:, 0].max() < 0.1
    # 32 if beams that end at peers are integrated: the peers' own scans clear most of their cells.
    assert highest <= 12


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_robots_that_collide_both_report_contact(physics):
    start = ((1.0, 2.0, 0.0), (2.0, 2.0, 0.0), (4.0, 2.0, 0.0))
    env, *_ = team_in(hall(), start, physics=physics, slam="truth")
    ahead = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]], dtype=np.float32)
    infos = [env.step(ahead)[4] for _ in range(60)]
    assert infos[0]["collisions"].tolist() == [0, 0, 0]
    assert (infos[-1]["collisions"] >= 1).tolist() == [True, True, False]
    assert min(info["rewards"]["collision"] for info in infos) == pytest.approx(2 * -0.5 * 0.1)
    first, second = (truth.state.pose for truth in env.truths[:2])
    if physics == "kinematic":
        assert tuple(second) == start[1]
        assert math.dist(first[:2], second[:2]) >= 2 * BURGER.radius - 1e-5
    else:
        # The robot that was hit rolls on.
        assert second.x > start[1][0] + 0.01
        assert math.dist(first[:2], second[:2]) > BURGER.radius
    env.close()


def test_area_counts_once_whoever_sees_it():
    start = ((1.0, 2.0, 0.0), (1.5, 2.0, 0.0))
    env, _, info = team_in(hall(3.0, 4.0), start, slam="truth", target_coverage=1.0)
    still = np.zeros((2, 2), dtype=np.float32)
    total = sum(env.step(still)[4]["rewards"]["explored"] for _ in range(10))
    single = LidarEnv(Explore, world=hall(3.0, 4.0), physics="kinematic", start=start[0], slam="truth")
    _, alone = single.reset(seed=0)
    assert alone["explored_area"] <= info["explored_area"] <= env.task.coverage.area.area
    assert info["explored_area"] + total == pytest.approx(env.task.coverage.explored_area)


def test_starts_keep_clear_of_what_moves():
    world = replace(hall(3.0, 3.0), people=(FixedRoute(0.4, np.array([[2.0, 1.5], [2.0, 2.0]]), 0.2),))
    area, first = explorable_area(world, BURGER, 0.05), Pose2D(0.5, 1.5, 0.0)
    for seed in range(5):
        starts = draw_starts(area, world, BURGER, first, 4, np.random.default_rng(seed))
        assert starts[0] == first
        assert min(math.dist((2.0, 1.5), pose[:2]) for pose in starts) > 0.4 + BURGER.radius
