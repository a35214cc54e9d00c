import numpy as np
import pytest

from agents.pursuit import UntrainedPursuit
from agents.run_folder import CheckpointError
from baselines import make_explorer
from baselines.episode import begin_episode, decide_with, run_episode
from benchmarks.arena.policies import parse_policy
from envs.core import LidarEnv
from envs.tasks.explore import Explore

ROOMS = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic", "target_coverage": 0.9}


def test_it_drives_as_the_policy_of_twists_does_before_its_training():
    env = LidarEnv(Explore, **ROOMS, observations=("motion", "plan"))
    policy, explorer = UntrainedPursuit(), make_explorer("pursuit")
    for seed in range(4):
        observation, _ = begin_episode(env, explorer, seed, np.random.default_rng(seed))
        assert decide_with(explorer, env)(observation) == pytest.approx(policy(observation), abs=0.02)


@pytest.mark.parametrize("name", ["pursuit", "pursuit:pretrained/frontiers"])
def test_it_explores_and_touches_nothing(name):
    env = LidarEnv(Explore, **ROOMS)
    for seed in range(3):
        episode = run_episode(env, parse_policy(name).make(env.action_space), seed)
        assert episode.explored_fraction >= 0.9
        assert episode.collisions == 0


def test_only_scores_of_frontiers_are_driven_by_pursuit():
    with pytest.raises(CheckpointError, match="twist holds no score of frontiers"):
        parse_policy("pursuit:pretrained/twist")
