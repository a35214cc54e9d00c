"""The simulator that slides the robot along its path."""

import numpy as np
import pytest

import envs  # noqa: F401
from envs.abstract import ExploreFrontiersAbstractEnv
from envs.explore_frontiers import ExploreFrontiersEnv
from envs.navigation import GainOverCost

QUICK = {"world": "rooms", "world_size": (8.0, 8.0), "target_coverage": 0.95}


def explore(env, seed):
    """Explore by a rule; return the last info, and all positions."""
    rule = GainOverCost()
    env.reset(seed=seed)
    positions = [env.explore.truths[0].state.pose[:2]]
    while True:
        _, _, terminated, truncated, info = env.step(np.int64(rule(env.candidates, env.belief).argmax()))
        positions.append(env.explore.truths[0].state.pose[:2])
        if terminated or truncated:
            return info, np.array(positions)


def test_spaces_are_those_of_the_real_one():
    abstract, real = ExploreFrontiersAbstractEnv(**QUICK), ExploreFrontiersEnv(physics="kinematic", **QUICK)
    assert abstract.observation_space == real.observation_space
    assert abstract.action_space == real.action_space


def test_worlds_are_explored_in_about_the_time_of_the_real_one():
    times = []
    abstract = ExploreFrontiersAbstractEnv(**QUICK, map_resolution=0.1)
    for env in (abstract, ExploreFrontiersEnv(physics="kinematic", slam="truth", **QUICK)):
        infos = [explore(env, seed)[0] for seed in range(6)]
        assert all(info["end_reason"] == "covered" for info in infos)
        times.append(np.mean([info["time"] for info in infos]))
    assert times[0] == pytest.approx(times[1], rel=0.3)


def test_the_robot_is_no_faster_than_it_is():
    env = ExploreFrontiersAbstractEnv(**QUICK)
    info, positions = explore(env, 3)
    assert info["path_length"] <= env.robot.max_v * info["time"] + 1e-6
    area = env.explore.task.coverage.area
    cells = area.walls.cells(positions)
    near = np.array([area.traversable[r - 1 : r + 2, c - 1 : c + 2].any() for r, c in cells])
    assert near.all()


def test_the_pose_drifts_as_asked_and_no_more():
    for drift, least, most in (((0.0, 0.0), 0.0, 1e-9), ((0.05, 0.02), 0.005, 0.25)):
        info, _ = explore(ExploreFrontiersAbstractEnv(**QUICK, drift=drift), 0)
        error, turn = info["pose_error"]
        assert least <= error <= most
        assert turn <= 0.1


def test_a_lidar_that_looks_ahead_looks_around():
    env = ExploreFrontiersAbstractEnv(world="rooms", world_size=(8.0, 8.0), robot="raspimouse", target_coverage=0.8)
    info, _ = explore(env, 1)
    assert info["explored_fraction"] > 0.5
