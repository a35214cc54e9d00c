"""Training environments, and adapters from Gymnasium to stable-baselines3."""

import multiprocessing
from collections.abc import Mapping
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec, load_env_creator
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from lidarnaut.agents.config import EnvironmentConfig, TrainingConfig
from lidarnaut.agents.networks import flat_space, flatten
from lidarnaut.baselines.episode import LastInfo
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.files import explain_unknown
from lidarnaut.envs.ids import arguments_of, find_spec
from lidarnaut.envs.vector import LidarVectorEnv
from lidarnaut.envs.worlds.library import Split

Observations = dict[str, np.ndarray]
"""Batch of observations: arrays by name, with sub-environments along axis 0."""
_EXACT = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.bool_)


def _make(entry: Any, **arguments: Any) -> gymnasium.Env:
    env = entry(**arguments)
    return env if env is env.unwrapped else LastInfo(env)


def _make_single(spec: EnvSpec, may_end: bool, arguments: dict[str, Any]) -> gymnasium.Env:
    env = gymnasium.make(spec, **arguments)
    return LastInfo(env) if may_end else env


def make_env(config: EnvironmentConfig, split: Split) -> gymnasium.Env:
    """Create an environment with the worlds of a split; ValueError if the configuration is invalid."""
    env = gymnasium.make(find_spec(config.id), **_arguments(config, split))
    try:
        lidar_env_of(env)
    except TypeError as error:
        why = f"environment.id: {config.id!r} has no task that declares measures; see lidarnaut.envs.task.Task"
        raise ValueError(why) from error
    return env


def make_vector(config: EnvironmentConfig, split: Split, num_envs: int) -> VectorEnv[Observations, Any, Any]:
    """Create a vector environment with same-step autoreset; each of `environment.robots` drives in an equal share.

    Raises ValueError if the id or an argument is invalid, or observations of the robots differ.
    """
    spec, arguments = find_spec(config.id), _arguments(config, split)
    entry: Any = spec.entry_point
    entry, mode = load_env_creator(entry) if isinstance(entry, str) else entry, config.vectorization
    settings: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
    variants: list[dict[str, Any]] = [{"robot": robot} for robot in config.robots] or [{}]
    if len(variants) > num_envs:
        raise ValueError(f"num_envs is {num_envs}, fewer than the {len(variants)} robots of environment.robots")
    if mode == "native" and (spec.additional_wrappers or (isinstance(entry, type) and not hasattr(entry, "outcome"))):
        mode = "sync"  # native workers support no wrappers
    if mode != "sync":
        # Never "fork": copies of processes with threads (torch) may deadlock.
        settings["context"] = "spawn"
        if "forkserver" in multiprocessing.get_all_start_methods():
            settings["context"] = "forkserver"
            multiprocessing.set_forkserver_preload(["lidarnaut.envs.vector"])
    if mode != "native":
        may_end = bool(spec.max_episode_steps or spec.additional_wrappers) or not isinstance(entry, type)
        makers = [partial(_make_single, spec, may_end, {**arguments, **variant}) for variant in variants]
        kind = AsyncVectorEnv if mode == "async" else SyncVectorEnv
        return kind([makers[i * len(makers) // num_envs] for i in range(num_envs)], **settings)
    settings |= {"num_workers": config.num_workers, "variants": variants}
    if spec.vector_entry_point is not None:
        return gymnasium.make_vec(spec, num_envs, "vector_entry_point", **settings, **arguments)
    settings["max_episode_steps"] = spec.max_episode_steps
    return LidarVectorEnv(partial(_make, entry), num_envs, **settings, **{**spec.kwargs, **arguments})


def make_vec_env(config: TrainingConfig, *, is_flat: bool = False) -> "GymnasiumVecEnv":
    """Create the training environments of one process. `is_flat`: flatten dictionary observations to vectors."""
    environment, size = config.environment, config.processes or 1
    if size > 1 and environment.num_workers is None:
        environment = environment.model_copy(update={"num_workers": 0})
    return GymnasiumVecEnv(make_vector(environment, "train", config.num_envs // size), is_flat=is_flat)


def _arguments(config: EnvironmentConfig, split: Split) -> dict[str, Any]:
    accepted, arguments = arguments_of(config.id), config.arguments
    if unknown := [name for name in arguments if name not in accepted]:
        raise ValueError(f"environment: {config.id} has no argument {explain_unknown(unknown[0], accepted)}")
    usual = {"split": split, "physics": "kinematic"}
    return {name: value for name, value in usual.items() if name in accepted} | arguments


def infos_of(info: Mapping[str, Any], num_envs: int) -> list[dict[str, Any]]:
    """Return the `info` of each sub-environment, without those of ended episodes.

    `info`: arrays by key, with masks as `_key`.
    """
    infos: list[dict[str, Any]] = [{} for _ in range(num_envs)]
    for key, values in info.items():
        mask = info.get(f"_{key}")
        if mask is None or key in ("final_info", "final_obs"):
            continue
        if isinstance(values, Mapping):
            values = infos_of(values, num_envs)
        elif values.ndim == 1 and values.dtype in _EXACT:
            values = values.tolist()  # numbers of Python, as single environments have
        for one, value, is_set in zip(infos, values, mask.tolist(), strict=True):
            if is_set:
                one[key] = value
    return infos


class GymnasiumVecEnv(VecEnv):
    """Adapter from a Gymnasium vector environment with same-step autoreset to stable-baselines3.

    Sub-environment i gets seed + i. `infos` hold what `DummyVecEnv` of monitored environments has; `episode` also holds
    the numbers of the last step.
    `env_method("action_masks")` returns the masks of the latest observations. Actions are not clipped: algorithms of
    stable-baselines3 clip Gaussian samples.
    """

    def __init__(self, env: VectorEnv, *, is_flat: bool = False) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f"stable-baselines3 needs autoreset_mode=AutoresetMode.SAME_STEP, got {mode}")
        self.env: Any = env
        self._is_flat = is_flat
        self._is_async = isinstance(env, LidarVectorEnv | AsyncVectorEnv)
        self._observations: Observations = {}
        self.parts: spaces.Dict = env.single_observation_space  # type: ignore[assignment]
        super().__init__(env.num_envs, flat_space(self.parts) if is_flat else self.parts, env.single_action_space)
        self._has_masks = isinstance(self.parts, spaces.Dict) and "action_mask" in self.parts.spaces
        self._returns, self._lengths = np.zeros(env.num_envs), np.zeros(env.num_envs, dtype=np.int64)

    def reset(self) -> Any:
        if any(options != self._options[0] for options in self._options):
            raise ValueError("options must be the same for all sub-environments")
        seeds: Any = self._seeds
        self._observations, info = self.env.reset(seed=seeds, options=self._options[0] or None)
        self.reset_infos = infos_of(info, self.num_envs)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = self._lengths[:] = 0
        return self._shown(self._observations)

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions
        if self._is_async:
            self.env.step_async(actions)

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        step = self.env.step_wait() if self._is_async else self.env.step(self._actions)
        self._observations, rewards, terminated, truncated, info = step
        self._returns += rewards
        self._lengths += 1
        dones = np.asarray(terminated) | np.asarray(truncated)
        infos, finals = infos_of(info, self.num_envs), infos_of(info.get("final_info", {}), self.num_envs)
        for i in np.flatnonzero(dones).tolist():
            self.reset_infos[i], infos[i] = infos[i], self._end_of_episode(finals[i], info["final_obs"][i], i)
        for i, is_cut in enumerate((dones & ~np.asarray(terminated)).tolist()):
            infos[i]["TimeLimit.truncated"] = is_cut
        return self._shown(self._observations), rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        self.env.close()

    def get_images(self) -> list[np.ndarray | None]:
        pictures: Any = self.env.render()
        return list(pictures or [None] * self.num_envs)

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        inner: Any = self.env.unwrapped
        chosen = self._get_indices(indices)
        if attr_name == "action_masks" and self._has_masks:
            return [None for _ in chosen]
        has_attributes = hasattr(inner, "get_attr")
        values = inner.get_attr(attr_name) if has_attributes else [getattr(inner, attr_name)] * self.num_envs
        return [values[i] for i in chosen]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        inner: Any = self.env.unwrapped
        chosen = set(self._get_indices(indices))
        values = [value] * self.num_envs if len(chosen) == self.num_envs else list(inner.get_attr(attr_name))
        inner.set_attr(attr_name, [value if i in chosen else values[i] for i in range(self.num_envs)])

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        chosen = list(self._get_indices(indices))
        if method_name == "action_masks" and self._has_masks:
            return list(self._observations["action_mask"].astype(np.bool_)[chosen])
        # `HerReplayBuffer` asks the first sub-environment to compute rewards, which changes nothing.
        if len(chosen) < self.num_envs and method_name != "compute_reward":
            raise ValueError(f"{method_name} can be called in all sub-environments, not in {chosen} alone")
        inner: Any = self.env.unwrapped
        results = list(inner.call(method_name, *args, **kwargs))
        return [results[i] for i in chosen]

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None) -> list[bool]:
        return [issubclass(wrapper_class, Monitor) for _ in self._get_indices(indices)]

    def _shown(self, observations: Observations) -> Any:
        return flatten(observations) if self._is_flat else observations

    def _end_of_episode(self, final: dict[str, Any], last: Observations, i: int) -> dict[str, Any]:
        numbers = {name: np.asarray(value) for name, value in final.items()}
        episode = {name: float(value.sum()) for name, value in numbers.items() if value.dtype.kind in "biuf"}
        episode |= {"r": float(self._returns[i]), "l": int(self._lengths[i])}
        self._returns[i] = self._lengths[i] = 0
        shown = flatten({name: part[None] for name, part in last.items()})[0] if self._is_flat else last
        return final | {"episode": episode, "terminal_observation": shown}
