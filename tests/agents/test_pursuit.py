"""The policy that starts from pursuit of the plan."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from agents.algorithms import Actor, build_model
from agents.checkpoint import load_checkpoint
from agents.config import TrainingConfig
from agents.explorer import LearnedPolicy
from agents.learned import find_policy
from agents.pursuit import BACK, SPIN, TURN, pursue
from agents.vec_env import GymnasiumVecEnv, make_env, make_vector
from baselines.episode import run_episode
from envs.files import parse_record, read_record

TINY = {
    "experiment": "tiny",
    "total_steps": 64,
    "num_envs": 2,
    "algorithm": "PPO",
    "environment": {"world": "rooms", "world_size": [7, 7], "control_hz": 5.0, "target_coverage": 0.95},
    "hyperparameters": {"n_steps": 32, "batch_size": 32},
    "network": {"pursuit": 1.0},
}
TINY["environment"] |= {"observations": ["scan", "motion", "plan"], "num_workers": 0}


def plan_of(angle, *, present=1.0):
    plan = torch.zeros(1, 27)
    plan[0, :2], plan[0, 8] = torch.tensor([math.cos(angle), math.sin(angle)]) * present, present
    return plan


@pytest.mark.parametrize(
    ("plan", "bumper", "twist"),
    [
        (plan_of(0.0), 0.0, (1.0, 0.0)),
        (plan_of(0.5), 0.0, (math.cos(0.5), 0.5 * TURN)),
        (plan_of(-0.5), 0.0, (math.cos(0.5), -0.5 * TURN)),
        (plan_of(2.5), 0.0, (0.0, 1.0)),
        (plan_of(0.5), 1.0, (BACK, 0.5 * TURN)),
        (plan_of(0.0, present=0.0), 0.0, (0.0, SPIN)),
    ],
)
def test_pursuit_turns_to_the_path_backs_up_in_contact_and_looks_around_without_a_path(plan, bumper, twist):
    motion = torch.tensor([[0.5, 0.5, 0.5, 0.5, bumper, 0.5]])
    assert pursue(plan, motion)[0].tolist() == pytest.approx(twist, abs=1e-6)


def test_an_untrained_policy_follows_the_plan_and_learns_beside_it():
    config = parse_record(TINY, "tiny", TrainingConfig)
    env = GymnasiumVecEnv(make_vector(config.environment, "train", 2))
    model = build_model(config, env)
    observations = env.reset()
    followed = pursue(torch.as_tensor(observations["plan"]), torch.as_tensor(observations["motion"])).numpy()
    np.testing.assert_allclose(Actor(model.policy)(observations), followed, atol=0.1)
    before = {name: weight.clone() for name, weight in model.policy.state_dict().items()}
    model.learn(64)
    after = model.policy.state_dict()
    assert all((after[name] != before[name]).any() for name in before if name.startswith("features_extractor.plan"))
    env.close()


def test_the_policy_of_the_package_explores_a_small_world_without_contact():
    driver = LearnedPolicy.load(find_policy("pretrained/twist"))
    config = parse_record(TINY, "tiny", TrainingConfig).environment
    env = make_env(config.model_copy(update={"robot": "turtlebot3_waffle_pi"}), "test")
    episode = run_episode(env, driver, 0)
    assert episode.end_reason == "covered"
    assert episode.duration < 0.5 * episode.time_limit
    assert episode.collisions <= 1


def test_the_policy_of_the_package_was_trained_by_its_configuration():
    config = read_record(Path(__file__).parents[2] / "configs" / "twist.yaml", TrainingConfig)
    record = load_checkpoint(find_policy("pretrained/twist"), policy_only=True).record
    # The name of the run and its number of processes change nothing of what is learned.
    own = {"seed": 1, "experiment": record.config.experiment}
    for name in ("environment", "hyperparameters", "network"):
        was, now = dict(getattr(record.config, name)), dict(getattr(config, name))
        # It was saved with all of its values, and in an older form.
        assert {key: was[key] for key in now} == now
        own[name] = getattr(record.config, name)
    assert record.config == config.model_copy(update=own)
    assert record.steps >= config.total_steps
