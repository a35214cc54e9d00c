from contextlib import closing

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3.common.logger import Logger
from torch import nn

import lidarnaut
from lidarnaut.agents import threads
from lidarnaut.agents.config import parse_config
from lidarnaut.agents.threads import split_batches
from lidarnaut.agents.vec_env import make_vec_env
from tests.agents.tiny import untrained

ROBOTS = ("turtlebot3_burger", "turtlebot3_burger")
TRAJECTORIES = ("trajectories", "goal", "motion", "limits")


def make(algorithm, id, num_envs=2, num_threads=1, network=None, hyperparameters=None, **arguments):
    environment = {"id": f"lidarnaut/{id}-v0", "num_workers": 0, "time_limit": 1.0, "world": "rooms", **arguments}
    data = {"experiment": "x", "total_steps": 10_000, "algorithm": algorithm, "num_envs": num_envs, "network": network}
    data |= {"environment": environment | {"world_size": [6, 6]}, "network": network or {}}
    data |= {"hyperparameters": {"n_steps": 4} | (hyperparameters or {}), "torch_threads": num_threads}
    config = parse_config(data, "test")
    env = make_vec_env(config)
    model = untrained(config, env)
    model.set_logger(Logger(None, []))
    return env, model


def outcome(policy, observations, actions):
    """Return values, logarithms of probabilities, entropies, and the gradients of a loss made of them."""
    policy.optimizer.zero_grad()
    outputs = policy.evaluate_actions(observations, actions)
    sum((k + 1) * (one * torch.linspace(0.0, 1.0, len(actions))).sum() for k, one in enumerate(outputs)).backward()
    gradients = [weight.grad.clone() for weight in policy.parameters() if weight.grad is not None]
    return [one.detach() for one in outputs] + gradients


@pytest.mark.parametrize(
    ("algorithm", "id", "arguments"),
    [
        ("PPO", "ReachGoal", {"observations": ("scan_history", "goal", "motion")}),
        ("A2C", "ReachGoal", {"observations": TRAJECTORIES}),
        ("MaskablePPO", "ExploreFrontiers", {}),
    ],
)
def test_parts_of_batches_give_the_gradients_of_the_whole_with_any_number_of_threads(algorithm, id, arguments):
    env, model = make(algorithm, id, **arguments)
    with closing(env):
        seen = {name: np.repeat(part, 301, axis=0)[:601] for name, part in env.reset().items()}
        rng = np.random.default_rng(0)
        for name, part in seen.items():
            if part.dtype == np.float32 and name != "action_mask":
                part += rng.uniform(0.0, 0.05, part.shape).astype(np.float32)
        seen = {name: torch.from_numpy(part) for name, part in seen.items()}
        policy, found = model.policy, []
        with torch.no_grad():
            actions = policy(seen)[0]
        del policy.evaluate_actions  # of the instance
        whole = outcome(policy, seen, actions)
        for num_threads in (1, 2, 3):
            split_batches(policy, num_threads)
            found.append(outcome(policy, seen, actions))
    for parts, *others in zip(*found, strict=True):
        assert all(torch.equal(parts, one) for one in others)
    assert len(whole) > 6
    for parts, one in zip(found[0], whole, strict=True):
        torch.testing.assert_close(parts, one, rtol=1e-4, atol=1e-4 * max(1.0, float(one.abs().max())))


@pytest.mark.parametrize(("algorithm", "num_processes"), [("PPO", 2), ("RecurrentPPO", 0), ("TRPO", 0)])
def test_trainings_are_equal_with_any_number_of_threads_and_processes(algorithm, num_processes, monkeypatch):
    monkeypatch.setattr(threads, "MIN_ROWS", 8)
    monkeypatch.setattr(threads, "MAX_PART", 8)
    weights = []
    hyperparameters = {"n_steps": 8, "batch_size": 40} | ({"n_epochs": 1} if algorithm != "TRPO" else {})
    for num_threads, num_workers in ((1, 0), (2, num_processes)):
        env, model = make(
            algorithm, "ReachGoal", 10, num_threads, hyperparameters=hyperparameters, num_workers=num_workers,
            robots=ROBOTS, observations=("scan", "goal"),
        )  # fmt: skip
        with closing(env):
            env.seed(5)
            model.learn(2 * 80)
            weights.append([weight.detach().clone() for weight in model.policy.parameters()])
    assert all(torch.equal(one, other) for one, other in zip(*weights, strict=True))


def test_networks_that_see_the_whole_batch_are_not_split():
    env, model = make("PPO", "ReachGoal", observations=("scan", "goal"))
    with closing(env):
        policy = type(model.policy)(env.observation_space, env.action_space, lambda _: 1e-3)
        policy.mlp_extractor.policy_net.append(nn.Dropout())
        split_batches(policy, 2)
    assert "evaluate_actions" not in vars(policy)
    assert "evaluate_actions" in vars(model.policy)


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_learned_policies_use_one_thread_and_leave_the_number_of_the_process(two_threads, monkeypatch):
    policy = lidarnaut.make_policy("pretrained/reach")
    assert torch.get_num_threads() == 2
    used = []

    def act(batch, starts):
        used.append(torch.get_num_threads())
        return np.zeros((1, 2), np.float32)

    monkeypatch.setattr(policy, "_actor", act)
    with closing(gymnasium.make(policy.id, physics="kinematic", **{**policy.arguments, "time_limit": 0.5})) as env:
        lidarnaut.run_episode(env, policy, 0)
        monkeypatch.setattr(policy, "_actor", lambda batch, starts: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            lidarnaut.run_episode(env, policy, 0)
    assert set(used) == {1}
    assert torch.get_num_threads() == 2
