"""Algorithms of stable-baselines3 and sb3-contrib: lookup, defaults and construction."""

import contextlib
import inspect
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from pydantic import ValidationError
from stable_baselines3 import A2C, PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy
from torch import nn

from lidarnaut.agents.checkpoint import POLICY_FILE, Checkpoint, check_tensors, damaged
from lidarnaut.agents.config import (
    ALGORITHMS,
    DecisionNetworkConfig,
    GaussianNetworkConfig,
    NetworkConfig,
    TrainingConfig,
    TrajectoryNetworkConfig,
)
from lidarnaut.agents.distributed import world_size
from lidarnaut.agents.frontiers.network import NEEDED, RULE, FrontierPolicy
from lidarnaut.agents.frontiers.score import FrontierScore
from lidarnaut.agents.hyperparameters import check_hyperparameter
from lidarnaut.agents.learned import find_policy
from lidarnaut.agents.networks import ExplorerFeatures, FlatFeatures, flat_space, flatten
from lidarnaut.agents.trajectories import TrajectoryPolicy
from lidarnaut.agents.vec_env import GymnasiumVecEnv, Observations
from lidarnaut.envs.files import SHORT, explain_unknown, load_object, parse_record
from lidarnaut.envs.processes import num_cores

_PPO = {"learning_rate": "lin_0.0007", "n_steps": 128, "batch_size": 512, "n_epochs": 4}
_ENTROPY = {"learning_rate": 1e-3, "gamma": 0.98, "ent_coef": "auto_0.05"}
DEFAULTS: dict[str, dict[str, Any]] = {
    "PPO": _PPO,
    "MaskablePPO": _PPO,
    "RecurrentPPO": _PPO | {"policy_kwargs": {"lstm_hidden_size": 64}},
    "OffPolicyAlgorithm": {"train_freq": 1, "gradient_steps": 4, "learning_starts": 1000, "batch_size": 256},
    "SAC": _ENTROPY | {"tau": 0.02},
    "TQC": _ENTROPY | {"tau": 0.02},
    "CrossQ": _ENTROPY,
    "TD3": {"learning_rate": 1e-3, "gamma": 0.98, "action_noise": 0.1},
}
"""Default hyperparameters by algorithm, if different from the library's. SAC starts with a small entropy bonus
(`auto_0.05`), because rewards per step are small."""
BUFFER_BYTES, BUFFER_STEPS = 2**30, 1_000_000
"""Maximum size of the default replay buffer: memory [bytes], and number of transitions."""
FIXED = {"policy", "env", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model", "monitor_wrapper"}
FIXED |= {"support_multi_env", "supported_action_spaces", "replay_buffer_class", "rollout_buffer_class", "sde_support"}
"""Constructor arguments of algorithms that this package sets. They are not allowed as hyperparameters."""


def find_algorithm(name: str) -> type[BaseAlgorithm]:
    """Return an algorithm class by name or `module:attribute`.

    Raises:
        ImportError: if sb3-contrib is required and missing.
        ValueError: if the class is unknown, or is not an `OnPolicyAlgorithm` or `OffPolicyAlgorithm`.
    """
    try:
        found = load_object(name if ":" in name else f"{ALGORITHMS[name]}:{name}")
    except ValueError as error:
        if ALGORITHMS.get(name) != "sb3_contrib" or "no module" not in str(error):
            raise
        extra = "pip install 'lidarnaut[contrib]', or -e '.[contrib]' in a checkout"
        raise ImportError(f"algorithm {name} needs sb3-contrib: {extra}") from error
    if not (isinstance(found, type) and issubclass(found, OnPolicyAlgorithm | OffPolicyAlgorithm)):
        raise ValueError(f"algorithm {name!r} must be derived from OnPolicyAlgorithm or OffPolicyAlgorithm")
    return found


def takes_vectors(algorithm: type[BaseAlgorithm]) -> bool:
    """Return True if an algorithm accepts only vectors, not dictionaries, as observations."""
    return _alias(algorithm).startswith("Mlp")


@dataclass(frozen=True, slots=True)
class Prepared:
    """Configuration of a training with all that is derived from it once, when the training begins."""

    config: TrainingConfig
    """Configuration with default hyperparameters and network settings filled in."""
    algorithm: type[BaseAlgorithm]
    network: Any
    """Network settings: `NetworkConfig`, or one of the other classes for networks."""
    hyperparameters: Mapping[str, Any]
    """Constructor arguments by hyperparameter, with schedules, noise and classes instead of their names."""
    rollout_steps: int
    """Number of environment steps between two updates."""
    num_updates: int
    """Number of policy updates: `total_steps` / steps between updates, rounded up."""


def prepare(config: TrainingConfig, algorithm: type[BaseAlgorithm], env: GymnasiumVecEnv) -> Prepared:
    """Fill in default hyperparameters and network settings, and check all of them.

    Raises:
        ValueError: if the device or a setting is invalid, or the steps between updates exceed `checkpoints.every`.
    """
    if config.device == "cuda" and not torch.cuda.is_available():  # stable-baselines3 would silently use the CPU
        raise ValueError("device is 'cuda', but torch finds no GPU; allowed values are 'cpu' and 'auto'")
    allowed = {name: one for name, one in _parameters(algorithm).items() if name not in FIXED}
    if unknown := [name for name in config.hyperparameters if name not in allowed]:
        raise ValueError(f"hyperparameters: {config.algorithm} has no {explain_unknown(unknown[0], allowed)}")
    given = {**_defaults(config, algorithm, env, allowed), **config.hyperparameters}
    steps = _rollout_steps(algorithm, allowed, given, config.num_envs)
    updates, values = -(-config.total_steps // steps), dict[str, Any]()
    for name, value in given.items():
        try:
            values[name] = _read(name, value, env.action_space, updates)
            check_hyperparameter(name, value, values[name], allowed[name].annotation)
        except ValueError as error:
            said = "; ".join(one["msg"] for one in error.errors()) if isinstance(error, ValidationError) else error
            raise ValueError(f"hyperparameters.{name}: {said}, got {SHORT.repr(value)}") from error
    network = _read_network(config, algorithm, env.parts, env.action_space)
    if config.checkpoints.every < steps:
        raise ValueError(
            f"checkpoints.every is {config.checkpoints.every}, but an update takes num_envs times "
            f"hyperparameters.n_steps (or train_freq) = {steps} steps; checkpoints are only saved between updates"
        )
    config = config.model_copy(update={"hyperparameters": given, "network": network.model_dump()})
    if (size := config.processes or 1) > 1 and "batch_size" in values:
        values["batch_size"] //= size
    return Prepared(config, algorithm, network, values, steps, updates)


def _defaults(config: TrainingConfig, algorithm: type, env: Any, allowed: Iterable[str]) -> dict[str, Any]:
    defaults: dict[str, Any] = {}
    for kind in reversed(algorithm.__mro__):
        defaults |= DEFAULTS.get(kind.__name__, {})
    if "buffer_size" in allowed and env is not None:
        seen = env.observation_space
        parts = seen.values() if isinstance(seen, spaces.Dict) else [seen]
        size = sum(np.dtype(space.dtype).itemsize * math.prod(space.shape or (1,)) for space in parts)
        affordable = BUFFER_BYTES // (2 * size)
        defaults = {"buffer_size": min(affordable, BUFFER_STEPS, max(config.total_steps, 1000))} | defaults
    return {name: value for name, value in defaults.items() if name in allowed}


def _rollout_steps(algorithm: type, allowed: Mapping[str, Any], given: Mapping[str, Any], num_envs: int) -> int:
    name = "n_steps" if issubclass(algorithm, OnPolicyAlgorithm) else "train_freq"
    value = given.get(name, allowed[name].default)
    steps, unit = value if isinstance(value, list | tuple) and len(value) == 2 else (value, "step")
    if type(steps) is not int or steps < 1 or (unit != "step" and num_envs > 1):
        further = ", or [number, step], or with num_envs 1 [number, episode]" if name == "train_freq" else ""
        raise ValueError(f"hyperparameters.{name} must be a whole number from 1{further}, got {SHORT.repr(value)}")
    return num_envs * (steps if unit == "step" else 1)


def num_processes(config: TrainingConfig, algorithm: type[BaseAlgorithm]) -> int:
    """Return the number of processes that train together: that of `torchrun`, `processes`, or by default one per core.

    Raises:
        ValueError: if the algorithm trains alone, or sub-environments or minibatches cannot be divided equally.
    """
    asked = world_size() or config.processes
    trains_alone = not issubclass(algorithm, OnPolicyAlgorithm) or any(k.__name__ == "TRPO" for k in algorithm.__mro__)
    if trains_alone or config.device != "cpu":
        if (asked or 1) > 1:
            why = f"algorithm {config.algorithm}" if trains_alone else f"device {config.device!r}"
            raise ValueError(f"processes: {asked} processes train together, but {why} allows only one")
        return 1
    names = _parameters(algorithm)
    shared = {"num_envs": config.num_envs}
    if "batch_size" in names:
        usual = _defaults(config, algorithm, None, names).get("batch_size", names["batch_size"].default)
        shared["hyperparameters.batch_size"] = config.hyperparameters.get("batch_size", usual)
    for name, count in shared.items():
        if asked and isinstance(count, int) and count % asked:
            raise ValueError(f"{name} is {count}, which {asked} processes cannot share equally")
    cores = 1 if os.environ.get("OMP_NUM_THREADS") == "1" else num_cores()  # set in workers of sweeps
    most = min(cores, config.num_envs // max(1, len(config.environment.robots)))
    fitting = [k for k in range(1, most + 1) if not any(isinstance(n, int) and n % k for n in shared.values())]
    return asked or max(fitting, default=1)


def build_model(prepared: Prepared, env: GymnasiumVecEnv) -> BaseAlgorithm:
    """Create an algorithm with an untrained policy; seed the global generators of NumPy and torch.

    Raises:
        ValueError: if the algorithm cannot be built with a hyperparameter.
        CheckpointError: if the folder in `network.prior_policy` does not contain a trained frontier score.
    """
    config, network = prepared.config, prepared.network
    torch.set_num_threads(config.torch_threads or 1)
    try:
        model = _construct(prepared, env)
    except Exception as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise ValueError(f"{_find_culprit(prepared, env)}: {said}") from error
    if isinstance(network, DecisionNetworkConfig) and network.prior_policy != RULE:
        model.policy.load_prior(FrontierScore.load(find_policy(network.prior_policy)))
    if isinstance(network, GaussianNetworkConfig):
        with torch.no_grad():
            model.policy.get_parameter("action_net.bias")[::2] = network.speed
    return model


def _construct(prepared: Prepared, env: GymnasiumVecEnv, without: str = "") -> Any:
    values = {name: value for name, value in prepared.hyperparameters.items() if name != without}
    arguments = _arguments(prepared.algorithm, prepared.network, env.parts, values)
    model = prepared.algorithm(env=env, seed=prepared.config.seed, device=prepared.config.device, **arguments)
    weight = nn.Parameter(torch.zeros(1))
    weight.grad = torch.zeros(1)
    policy: Any = model.policy
    settings = {name: value for name, value in policy.optimizer_kwargs.items() if name != "fused"}  # hides overflows
    policy.optimizer_class([weight], lr=model.lr_schedule(1.0), **settings).step()
    return model


def _find_culprit(prepared: Prepared, env: GymnasiumVecEnv) -> str:
    for name in prepared.hyperparameters:
        with contextlib.suppress(Exception):
            _construct(prepared, env, without=name)
            return f"hyperparameters.{name}"
    return f"{prepared.config.algorithm} cannot be built"


class NoOptimizer:
    """Placeholder optimizer for inference. A real optimizer would load torch's compiler."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        pass


def build_policy(checkpoint: Checkpoint, folder: Path) -> BasePolicy:
    """Return the policy network of a checkpoint for inference; CheckpointError if weights do not fit."""
    record = checkpoint.record
    parts = spaces.Dict({key: box.space() for key, box in record.observation.items()})
    try:
        action_space: Any = record.action.space()
        algorithm = find_algorithm(record.config.algorithm)
        network = _read_network(record.config, algorithm, parts, action_space)
        values = {name: _read(name, value, action_space) for name, value in record.config.hyperparameters.items()}
        values |= {"n_steps": 2} if issubclass(algorithm, OnPolicyAlgorithm) else {"buffer_size": 1}
        arguments = _arguments(algorithm, network, parts, values)
        arguments["policy_kwargs"]["optimizer_class"] = NoOptimizer
        model = algorithm(env=None, device="cpu", _init_setup_model=False, **arguments)  # type: ignore[call-arg]
        model.observation_space = flat_space(parts) if takes_vectors(algorithm) else parts
        model.action_space, model.n_envs = action_space, 1
        model.env = SimpleNamespace(action_space=action_space)  # type: ignore[assignment]
        model._setup_model()
    except ImportError:
        raise
    except Exception as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise damaged(folder, f"no network can be built for its spaces and configuration ({said})") from error
    check_tensors(folder, POLICY_FILE, checkpoint.policy, model.policy.state_dict())
    model.policy.load_state_dict(checkpoint.policy)
    model.policy.set_training_mode(False)
    return model.policy


class Actor:
    """Callable that returns actions of a policy, and keeps recurrent (LSTM) state between calls."""

    def __init__(self, policy: BasePolicy, *, deterministic: bool = True) -> None:
        self.policy, self._deterministic = policy, deterministic
        self._is_flat = isinstance(policy.observation_space, spaces.Box)
        self._takes_masks = "action_masks" in inspect.signature(policy.predict).parameters
        self._state: Any = None

    def __call__(self, observations: Observations, starts: np.ndarray | None = None) -> np.ndarray:
        """Return actions, shape (num_envs, ...); `starts` marks new episodes, shape (num_envs,), bool."""
        masks: dict[str, Any] = {}
        if self._takes_masks and "action_mask" in observations:
            masks = {"action_masks": observations["action_mask"].astype(np.bool_)}
        seen: Any = flatten(observations) if self._is_flat else observations
        arguments = {"episode_start": starts, "deterministic": self._deterministic, **masks}
        actions, self._state = self.policy.predict(seen, self._state, **arguments)
        return actions


def _parameters(algorithm: type[BaseAlgorithm]) -> dict[str, inspect.Parameter]:
    found: dict[str, inspect.Parameter] = {}
    for kind in algorithm.__mro__:
        parameters = inspect.signature(kind).parameters
        found = {name: one for name, one in parameters.items() if one.kind != one.VAR_KEYWORD} | found
        if all(one.kind != one.VAR_KEYWORD for one in parameters.values()):
            break
    return found


def _alias(algorithm: type[BaseAlgorithm]) -> str:
    found = [name for name in algorithm.policy_aliases if name.startswith(("MultiInput", "Mlp"))]
    if not found:
        raise ValueError(f"algorithm {algorithm.__name__} has no policy for dictionary or vector observations")
    return sorted(found, reverse=True)[0]


def _read_network(
    config: TrainingConfig, algorithm: type, parts: spaces.Dict, action_space: spaces.Space
) -> NetworkConfig | TrajectoryNetworkConfig | DecisionNetworkConfig:
    kind: type = NetworkConfig
    if isinstance(action_space, spaces.Box) and issubclass(algorithm, PPO | A2C) and "trajectories" in parts.spaces:
        kind = TrajectoryNetworkConfig
    elif isinstance(action_space, spaces.Box) and issubclass(algorithm, OnPolicyAlgorithm):
        kind = GaussianNetworkConfig
    elif isinstance(action_space, spaces.Discrete) and issubclass(algorithm, PPO | A2C) and {*NEEDED} <= {*parts}:
        kind = DecisionNetworkConfig
    return parse_record(config.network, "network", kind)


def _arguments(
    algorithm: type[BaseAlgorithm], network: Any, parts: spaces.Dict, hyperparameters: Mapping[str, Any]
) -> dict[str, Any]:
    policy: Any = algorithm.policy_aliases[_alias(algorithm)]
    if isinstance(network, DecisionNetworkConfig | TrajectoryNetworkConfig):
        policy = FrontierPolicy if isinstance(network, DecisionNetworkConfig) else TrajectoryPolicy
        own: dict[str, Any] = {"network": network.model_dump()}
    else:
        features = {"features_dim": network.features, "channels": network.channels}
        own = {
            "features_extractor_class": FlatFeatures if takes_vectors(algorithm) else ExplorerFeatures,
            "features_extractor_kwargs": features | ({"parts": parts} if takes_vectors(algorithm) else {}),
            "net_arch": [network.hidden],
            "activation_fn": nn.ReLU,
            "normalize_images": False,
        }
    if isinstance(network, GaussianNetworkConfig):
        own["log_std_init"] = network.log_std
    given = dict(hyperparameters.get("policy_kwargs", {}))
    if issubclass(algorithm, OnPolicyAlgorithm) and "optimizer_class" not in given:
        # The library's epsilon, which it uses only without `optimizer_kwargs`; one kernel for all weights.
        given["optimizer_kwargs"] = {"eps": 1e-5, "fused": True} | given.get("optimizer_kwargs", {})
    return {**hyperparameters, "policy": policy, "policy_kwargs": own | given}


def _read(name: str, value: Any, action_space: spaces.Space, num_updates: int = 1) -> Any:
    """Return the constructor argument of a hyperparameter, or an entry of its mapping."""
    if isinstance(value, dict):
        return {key: _read(key, one, action_space, num_updates) for key, one in value.items()}
    if name == "action_noise" and isinstance(value, int | float) and isinstance(action_space, spaces.Box):
        zeros = np.zeros(action_space.shape)
        return NormalActionNoise(zeros, zeros + value)
    if isinstance(value, str) and value.startswith("lin_"):
        try:
            rate = float(value.removeprefix("lin_"))
            if not 0.0 <= rate < math.inf:
                raise ValueError
        except ValueError:
            raise ValueError("not of the form lin_3e-4") from None
        # Count the finished rollout as remaining, to avoid a last update at rate 0.
        return lambda progress: rate * min(progress + 1.0 / num_updates, 1.0)
    if isinstance(value, str) and ":" in value:
        return load_object(value)
    return tuple(value) if name == "train_freq" and isinstance(value, list) else value
