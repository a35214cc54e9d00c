import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import MultiInputActorCriticPolicy

from agents.config import NetworkConfig
from agents.ppo import _policy_arguments, mean_action
from envs.explore import ExploreEnv
from tests.rollouts import rollout


def test_rollouts_updates_and_evaluations_see_the_same():
    env = ExploreEnv(physics="kinematic", control_hz=5.0)
    steps = rollout(env, 0, 40)
    torch.manual_seed(0)
    policy = MultiInputActorCriticPolicy(
        env.observation_space, spaces.Box(-1, 1, (2,)), lambda _: 0.0, **_policy_arguments(NetworkConfig())
    )
    seen = {key: np.stack([step[0][key] for step in steps[::8]]) for key in steps[0][0]}
    tensors = {key: torch.as_tensor(value) for key, value in seen.items()}
    with torch.no_grad():
        actions, values, _ = policy(tensors, deterministic=True)
        for ways in (policy.predict_values(tensors), policy.evaluate_actions(tensors, actions)[0]):
            assert torch.allclose(ways, values, atol=1e-6)
        blind = {**tensors, "map_near": torch.zeros_like(tensors["map_near"])}
        assert (policy.get_distribution(blind).mode() - actions).abs().max() > 1e-3
    assert np.allclose(mean_action(policy, seen), actions.numpy(), atol=1e-6)
