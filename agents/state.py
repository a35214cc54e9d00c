"""Conversion between stable-baselines3 models and checkpoints."""

import contextlib
from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import Tensor
from torch.nn.modules.module import register_module_forward_hook
from torch.optim import Optimizer

from lidarnaut.agents.checkpoint import (
    POLICY_FILE,
    TRAINING_FILE,
    Checkpoint,
    Record,
    SpaceRecord,
    check_tensors,
    damaged,
)
from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.curves import Row
from lidarnaut.agents.run_folder import CheckpointError

COUNTERS = ("_episode_num", "_n_calls", "exploration_rate")


def capture(model: BaseAlgorithm, config: TrainingConfig, evaluations: list[Row], control_hz: float) -> Checkpoint:
    """Return the training state of a model between two updates, without the replay buffer."""
    state: Any = np.random.get_state()  # noqa: NPY002
    algorithm, key, position, has_gauss, gauss = state
    env: Any = model.env
    record = Record(
        steps=model.num_timesteps,
        updates=model._n_updates,
        config=config,
        observation={name: SpaceRecord.of(space) for name, space in env.parts.spaces.items()},
        action=SpaceRecord.of(model.action_space),
        numpy_random=(algorithm, int(position), int(has_gauss), float(gauss)),
        action_random=dict(model.action_space.np_random.bit_generator.state),
        counters={name: getattr(model, name) for name in COUNTERS if hasattr(model, name)},
        evaluations=evaluations,
        control_hz=control_hz,
    )
    moments = {name: state[moment] for name, (state, moment) in _moments(model).items()}
    training = {name: torch.as_tensor(value).detach().cpu().clone() for name, value in moments.items()}
    training |= {f"variable.{name}": value.detach().cpu().clone() for name, value in _variables(model).items()}
    training["random.numpy"] = torch.from_numpy(np.asarray(key).astype(np.int64))
    training["random.torch"] = torch.get_rng_state()
    weights = {name: weight.detach().cpu().clone().contiguous() for name, weight in model.policy.state_dict().items()}
    return Checkpoint(record, weights, training)


def restore(model: BaseAlgorithm, checkpoint: Checkpoint, folder: Path) -> None:
    """Load a checkpoint into a new model and the global random generators; CheckpointError on mismatch."""
    record, tensors = checkpoint.record, checkpoint.training
    check_tensors(folder, POLICY_FILE, checkpoint.policy, model.policy.state_dict())
    # Optimizer state of a weight begins at its first update.
    _begin_moments(model, {name.rpartition(".")[0] for name in tensors})
    moments = _moments(model)
    needed = {name: torch.as_tensor(state[moment]) for name, (state, moment) in moments.items()}
    needed |= {f"variable.{name}": value for name, value in _variables(model).items()}
    needed |= {"random.numpy": torch.zeros(624, dtype=torch.int64), "random.torch": torch.get_rng_state()}
    check_tensors(folder, TRAINING_FILE, tensors, needed)

    model.policy.load_state_dict(checkpoint.policy)
    for name, (state, moment) in moments.items():
        is_tensor = isinstance(state[moment], Tensor)
        state[moment] = tensors[name].clone().to(state[moment].device) if is_tensor else tensors[name].item()
    for name, value in _variables(model).items():
        value.data.copy_(tensors[f"variable.{name}"])
    model.num_timesteps, model._n_updates = record.steps, record.updates
    for name, count in record.counters.items():
        if name in COUNTERS:
            setattr(model, name, count)
    algorithm, position, has_gauss, gauss = record.numpy_random
    np.random.set_state((algorithm, tensors["random.numpy"].numpy().astype(np.uint32), position, has_gauss, gauss))  # noqa: NPY002
    torch.set_rng_state(tensors["random.torch"])
    if record.action_random:
        try:
            model.action_space.np_random.bit_generator.state = record.action_random
        except (ValueError, TypeError, KeyError) as error:
            raise damaged(folder, f"checkpoint.json: action_random: {error}") from error
    if model.device.type == "cuda":  # checkpoints lack the GPU's generator
        seed = np.random.SeedSequence([record.config.seed, record.steps]).generate_state(1)[0]
        torch.cuda.manual_seed_all(int(seed))


def is_finite(model: BaseAlgorithm) -> bool:
    """Return True if the weights of a policy, and the outputs of its layers for the latest observations, are finite."""
    found = [*model.policy.parameters()]
    hook = register_module_forward_hook(lambda layer, given, output: found.append(output))
    with hook, contextlib.suppress(Exception):  # of a distribution, or before the first episode
        model.policy.predict(model._last_obs)  # type: ignore[arg-type]
    return all(bool(torch.isfinite(one).all()) for one in found if isinstance(one, Tensor))


def check_spaces(record: Record, parts: Mapping[str, spaces.Space], action_space: spaces.Space, name: str) -> None:
    """Raise CheckpointError if environment spaces differ from those of checkpoint `name`."""
    offered: dict[str, Any] = {"action": action_space, **parts}
    needed = {**record.observation, "action": record.action}
    wrong = [
        f"{key} {space} (here: {offered.get(key, 'none')})"
        for key, space in needed.items()
        if key not in offered or SpaceRecord.of(offered[key]) != space
    ]
    if wrong or offered.keys() != needed.keys():
        raise CheckpointError(f"{name} was trained on other spaces; it needs {', '.join(wrong) or list(needed)}")


def _optimizers(model: BaseAlgorithm) -> list[Optimizer]:
    found = [attrgetter(name)(model) for name in model._get_torch_save_params()[0]]
    return [one for one in found if isinstance(one, Optimizer)]


def _variables(model: BaseAlgorithm) -> dict[str, Tensor]:
    return {name: attrgetter(name)(model) for name in model._get_torch_save_params()[1]}


def _weight_names(model: BaseAlgorithm) -> dict[Tensor, str]:
    weights = {weight: name for name, weight in model.policy.named_parameters()}
    return weights | {value: name for name, value in _variables(model).items()}


def _moments(model: BaseAlgorithm) -> dict[str, tuple[dict[str, Any], str]]:
    names = _weight_names(model)
    return {
        f"optimizer.{names[weight]}.{moment}": (state, moment)
        for optimizer in _optimizers(model)
        for weight, state in optimizer.state.items()
        for moment, value in state.items()
        if isinstance(value, Tensor | int | float)
    }


def _begin_moments(model: BaseAlgorithm, begun: set[str]) -> None:
    names = _weight_names(model)
    for optimizer in _optimizers(model):
        for weight in (weight for group in optimizer.param_groups for weight in group["params"]):
            weight.grad = torch.zeros_like(weight) if f"optimizer.{names[weight]}" in begun else None
        optimizer.step()
        optimizer.zero_grad()
