"""PPO of stable-baselines3 for the exploration environments, and its conversion to and from checkpoints."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy, MultiInputActorCriticPolicy
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn

from agents.checkpoint import POLICY_FILE, TRAINING_FILE, Checkpoint, Record, check_tensors, damaged, record_of
from agents.config import NetworkConfig, TrainingConfig
from agents.curves import Row
from agents.frontiers.policy import RULE, FrontierPolicy
from agents.frontiers.score import FrontierScore
from agents.learned import find_policy
from agents.networks import ExplorerFeatures
from agents.pursuit import PursuitPolicy
from agents.run_folder import CheckpointError
from agents.vec_env import Observations

MOMENTS = ("exp_avg", "exp_avg_sq", "step")
"""What Adam keeps for each weight."""


def build_model(config: TrainingConfig, env: VecEnv) -> PPO:
    """Make a fresh model. Seeds the global generators of NumPy and torch, which stable-baselines3 draws from.

    Raises:
        ValueError: if the device is `cuda` and torch sees no GPU.
        CheckpointError: if `decision_network.prior_policy` names no score of frontiers.
    """
    ppo = config.ppo
    if config.device == "cuda" and not torch.cuda.is_available():  # stable-baselines3 would take the CPU silently
        raise ValueError("device is 'cuda', but torch sees no GPU; allowed here are 'cpu' and 'auto'")
    torch.set_num_threads(config.torch_threads)

    def learning_rate(progress_remaining: float) -> float:
        # The library asks after a rollout; counting that rollout as still to do spares a last update at rate zero.
        remaining = min(progress_remaining + 1.0 / config.num_updates, 1.0)
        return ppo.learning_rate * (remaining if ppo.anneal else 1.0)

    policy, arguments = _policy(config, env.action_space)
    model = PPO(
        policy,
        env,
        learning_rate=learning_rate,
        n_steps=ppo.num_steps,
        batch_size=ppo.batch_size,
        n_epochs=ppo.num_epochs,
        gamma=ppo.gamma,
        gae_lambda=ppo.gae_lambda,
        clip_range=ppo.clip_range,
        ent_coef=ppo.entropy_coef,
        vf_coef=ppo.value_coef,
        max_grad_norm=ppo.max_grad_norm,
        target_kl=ppo.target_kl,
        policy_kwargs=arguments,
        seed=config.seed,
        device=config.device,
    )
    if isinstance(model.policy, FrontierPolicy):
        if (name := config.decision_network.prior_policy) != RULE:
            model.policy.load_prior(FrontierScore.load(find_policy(name)))
    else:
        with torch.no_grad():
            model.policy.get_parameter("action_net.bias")[0] = config.network.speed
    return model


def build_policy(checkpoint: Checkpoint, folder: Path) -> ActorCriticPolicy:
    """Make the policy of a checkpoint, for acting only.

    Raises:
        CheckpointError: if the weights do not fit the network that the checkpoint describes.
    """
    record = checkpoint.record
    observation_space = spaces.Dict({key: box.space() for key, box in record.observation.items()})
    action_space = record.action.space()
    make, arguments = _policy(record.config, action_space)
    try:
        policy = make(observation_space, action_space, lambda _: 0.0, **arguments)
    except Exception as error:  # networks raise many kinds for shapes that they cannot be made for
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise damaged(folder, f"there is no network for its spaces and its configuration ({said})") from error
    check_tensors(folder, POLICY_FILE, checkpoint.policy, policy.state_dict())
    policy.load_state_dict(checkpoint.policy)
    policy.set_training_mode(False)
    return policy


def mean_action(policy: ActorCriticPolicy, observations: Observations) -> np.ndarray:
    """Return the policy's most likely actions.

    Shape (batch, num_actions), float32, for twists: their means, which may lie outside [-1, 1]; (batch,), int64, for
    choices.
    """
    with torch.no_grad():
        tensors = {key: torch.as_tensor(value, device=policy.device) for key, value in observations.items()}
        actions = policy.get_distribution(tensors).mode()
    return actions.cpu().numpy()


def capture(model: PPO, config: TrainingConfig, evaluations: list[Row]) -> Checkpoint:
    """Take the state of a training between two updates."""
    assert isinstance(model.observation_space, spaces.Dict)
    state: Any = np.random.get_state()  # noqa: NPY002
    algorithm, key, position, has_gauss, gauss = state
    record = Record(
        steps=model.num_timesteps,
        updates=model._n_updates,
        config=config,
        observation={name: record_of(space) for name, space in model.observation_space.spaces.items()},
        action=record_of(model.action_space),
        numpy_random=(algorithm, int(position), int(has_gauss), float(gauss)),
        evaluations=evaluations,
    )
    moments = model.policy.optimizer.state_dict()["state"]
    training = {
        f"optimizer.{name}.{moment}": torch.as_tensor(moments[index][moment]).cpu().clone()
        for index, (name, _) in enumerate(model.policy.named_parameters())
        for moment in MOMENTS
        if index in moments
    }
    training["random.numpy"] = torch.from_numpy(np.asarray(key).astype(np.int64))
    training["random.torch"] = torch.get_rng_state()
    weights = {name: weight.detach().cpu().clone().contiguous() for name, weight in model.policy.state_dict().items()}
    return Checkpoint(record, weights, training)


def restore(model: PPO, checkpoint: Checkpoint, folder: Path) -> None:
    """Bring a fresh model, and the global generators, to the state of a checkpoint.

    Raises:
        CheckpointError: if the checkpoint was made with other spaces or another network, or is damaged.
    """
    record = checkpoint.record
    check_spaces(record, model.observation_space, model.action_space, str(folder))
    weights = model.policy.state_dict()
    check_tensors(folder, POLICY_FILE, checkpoint.policy, weights)
    parameters = dict(model.policy.named_parameters())
    needed: dict[str, Tensor] = {
        "random.numpy": torch.zeros(624, dtype=torch.int64),
        "random.torch": torch.get_rng_state(),
    }
    if record.updates:
        for name, weight in parameters.items():
            needed |= {f"optimizer.{name}.{moment}": weight for moment in MOMENTS[:2]}
            needed[f"optimizer.{name}.step"] = torch.tensor(0.0)
    check_tensors(folder, TRAINING_FILE, checkpoint.training, needed)

    model.policy.load_state_dict(checkpoint.policy)
    if record.updates:
        moments = {
            index: {moment: checkpoint.training[f"optimizer.{name}.{moment}"].clone() for moment in MOMENTS}
            for index, name in enumerate(parameters)
        }
        optimizer = model.policy.optimizer
        optimizer.load_state_dict({**optimizer.state_dict(), "state": moments})
    model.num_timesteps = record.steps
    model._n_updates = record.updates
    algorithm, position, has_gauss, gauss = record.numpy_random
    key = checkpoint.training["random.numpy"].numpy().astype(np.uint32)
    np.random.set_state((algorithm, key, position, has_gauss, gauss))  # noqa: NPY002
    torch.set_rng_state(checkpoint.training["random.torch"])
    if model.device.type == "cuda":  # A GPU draws from a generator of its own, which a checkpoint does not hold.
        seed = np.random.SeedSequence([record.config.seed, record.steps]).generate_state(1)[0]
        torch.cuda.manual_seed_all(int(seed))


def check_spaces(record: Record, observation_space: spaces.Space, action_space: spaces.Space, name: str) -> None:
    """Hold the spaces of an environment against those of a checkpoint of some name.

    Raises:
        CheckpointError: if they differ; says which space is needed and which is there.
    """
    offered: dict[str, Any] = {"action": action_space}
    if isinstance(observation_space, spaces.Dict):
        offered |= observation_space.spaces
    needed = {**record.observation, "action": record.action}
    wrong = [
        f"{key} {space} (here: {offered.get(key, 'none')})"
        for key, space in needed.items()
        if key not in offered or record_of(offered[key]) != space
    ]
    if wrong or offered.keys() != needed.keys():
        raise CheckpointError(f"{name} was trained on other spaces; it needs {', '.join(wrong) or list(needed)}")


def _policy(config: TrainingConfig, action_space: spaces.Space) -> tuple[type[ActorCriticPolicy], dict[str, Any]]:
    """Return the policy for an action space, and its own arguments."""
    if isinstance(action_space, spaces.Discrete):
        return FrontierPolicy, config.decision_network.model_dump()
    arguments = _policy_arguments(config.network)
    if config.network.pursuit:
        return PursuitPolicy, {**arguments, "weight": config.network.pursuit}
    return MultiInputActorCriticPolicy, arguments


def _policy_arguments(network: NetworkConfig) -> dict[str, Any]:
    return {
        "features_extractor_class": ExplorerFeatures,
        "features_extractor_kwargs": {"features_dim": network.features, "channels": network.channels},
        "net_arch": {"pi": [network.hidden], "vf": [network.hidden]},
        "activation_fn": nn.ReLU,
        "log_std_init": network.log_std,
        "normalize_images": False,  # the network scales crops by their weights, of which there are fewer
    }
