import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import MultiInputActorCriticPolicy

from agents.algorithms import Actor, build_model
from agents.checkpoint import load_checkpoint
from agents.config import TrainingConfig
from agents.networks import ExplorerFeatures
from agents.run_folder import find_checkpoint
from agents.training import train
from envs.core import LidarEnv
from envs.files import parse_record
from envs.tasks.explore import Explore
from tests.rollouts import rollout


def test_rollouts_updates_and_evaluations_see_the_same():
    env = LidarEnv(Explore, physics="kinematic", control_hz=5.0)
    steps = rollout(env, 0, 40)
    torch.manual_seed(0)
    policy = MultiInputActorCriticPolicy(
        env.observation_space,
        spaces.Box(-1, 1, (2,)),
        lambda _: 0.0,
        features_extractor_class=ExplorerFeatures,
        normalize_images=False,
    )
    seen = {key: np.stack([step[0][key] for step in steps[::8]]) for key in steps[0][0]}
    tensors = {key: torch.as_tensor(value) for key, value in seen.items()}
    with torch.no_grad():
        actions, values, _ = policy(tensors, deterministic=True)
        for predicted in (policy.predict_values(tensors), policy.evaluate_actions(tensors, actions)[0]):
            assert torch.allclose(predicted, values, atol=1e-6)
        blind = {**tensors, "map_near": torch.zeros_like(tensors["map_near"])}
        assert (policy.get_distribution(blind).mode() - actions).abs().max() > 1e-3
    assert np.allclose(Actor(policy)(seen), actions.numpy(), atol=1e-6)


def test_a_missing_gpu_is_reported(tiny_config, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match="torch sees no GPU; allowed here are 'cpu' and 'auto'"):
        build_model(tiny_config.model_copy(update={"device": "cuda"}), env=None)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_training_on_a_gpu_goes_on_anywhere(tiny_data, tmp_path):
    config = parse_record({**tiny_data, "total_steps": 256, "device": "cuda"}, "mem", TrainingConfig)
    run = train(config, run=tmp_path / "run", progress=False)
    more = config.model_copy(update={"total_steps": 512, "device": "cpu"})
    train(more, resume=run, progress=False)
    assert load_checkpoint(find_checkpoint(run)).record.steps == 512
