from types import SimpleNamespace

import numpy as np
import pytest
import torch

from agents.algorithms import Actor, build_model
from agents.explorer import LearnedPolicy
from agents.learned import find_policy
from agents.run_folder import CheckpointError
from agents.vec_env import GymnasiumVecEnv, make_env, make_vector
from envs.geometry import wrap_angle
from envs.robots import load_robot
from tests.agents.fake_env import BEAMS


@pytest.fixture
def env(tiny_config):
    return make_env(tiny_config.environment, "test")


def ready(explorer, env, seed=0):
    explorer.reset(env.unwrapped.robot, env.unwrapped.control_period, np.random.default_rng(seed))
    return explorer


def test_drawn_actions_come_from_the_generator_alone(tiny_run, env):
    explorer = LearnedPolicy.load(tiny_run, deterministic=False)
    observation, _ = env.reset(seed=1)

    def draw(seed):
        torch.rand(3)
        ready(explorer, env, seed)
        return np.array([explorer(observation) for _ in range(400)])

    first = draw(5)
    assert np.array_equal(first, draw(5))
    assert not np.array_equal(first, draw(6))
    mean = ready(LearnedPolicy.load(tiny_run), env)(observation)
    assert np.allclose(first.mean(axis=0), mean, atol=0.15)
    assert (first.std(axis=0) > 0.3).all()


def test_what_does_not_fit_is_reported(tiny_run, env):
    explorer = LearnedPolicy.load(tiny_run)
    robot = SimpleNamespace(name="other", lidar=SimpleNamespace(num_beams=360))
    with pytest.raises(CheckpointError, match=f"needs scans of {BEAMS} beams, but the lidar of robot 'other' has 360"):
        explorer.reset(robot, 0.2, np.random.default_rng(0))
    ready(explorer, env)
    observation, _ = env.reset(seed=1)
    del observation["map_far"]
    with pytest.raises(CheckpointError, match=r"needs observations .*map_far Box\(0, 255, \(3, 40, 40\), uint8\)"):
        explorer(observation)


def test_scans_of_other_lidars_are_shown_as_that_of_the_training():
    def act(name, distance):
        """Act by what the lidar of a robot sees of a wall ahead [m]."""
        explorer, robot = LearnedPolicy.load(find_policy("pretrained/twist")), load_robot(name)
        explorer.reset(robot, 0.2, np.random.default_rng(0))
        bearings = wrap_angle(robot.lidar.angles + robot.lidar.mount.yaw)
        ranges = np.where(np.abs(bearings) < 0.5, distance, np.inf)
        scan = np.minimum(ranges / robot.lidar.range_max, 1.0).astype(np.float32)
        return explorer({"scan": scan, "motion": np.zeros(6, np.float32), "plan": np.zeros(27, np.float32)})

    trained = "turtlebot3_waffle_pi"
    assert act("create3", 0.4) == pytest.approx(act(trained, 0.4), abs=0.005)
    assert act(trained, 0.4) != pytest.approx(act(trained, np.inf), abs=0.005)


def test_an_untrained_policy_drives_ahead_as_configured(tiny_config):
    vector = GymnasiumVecEnv(make_vector(tiny_config.environment, "train", 4))
    model = build_model(tiny_config.model_copy(update={"network": {"speed": 0.6}}), vector)
    assert Actor(model.policy)(vector.reset())[0] == pytest.approx([0.6, 0.0], abs=0.1)
