"""Training environments, and adapters from Gymnasium to stable-baselines3."""

import contextlib
import multiprocessing
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import load_env_creator
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, VectorEnv
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


def _make(entry: Any, **arguments: Any) -> gymnasium.Env:
    env = entry(**arguments)
    return env if env is env.unwrapped else LastInfo(env)


def make_env(config: EnvironmentConfig, split: Split) -> gymnasium.Env:
    """Create an environment with the worlds of a split; ValueError if the configuration is invalid."""
    env = gymnasium.make(find_spec(config.id), **_arguments(config, split))
    try:
        lidar_env_of(env)
    except TypeError as error:
        why = f"environment.id: {config.id!r} has no task that declares measures; see lidarnaut.envs.task.Task"
        raise ValueError(why) from error
    return env


def make_vector(
    config: EnvironmentConfig, split: Split, num_envs: int
) -> VectorEnv[Observations, np.ndarray, np.ndarray]:
    """Create a vector environment with same-step autoreset; raise ValueError if id or argument is invalid."""
    spec, arguments = find_spec(config.id), _arguments(config, split)
    entry: Any = spec.entry_point
    entry, mode = load_env_creator(entry) if isinstance(entry, str) else entry, config.vectorization
    settings: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
    if mode == "native" and (spec.additional_wrappers or (isinstance(entry, type) and not hasattr(entry, "outcome"))):
        mode = "sync"  # native workers support no wrappers
    if mode != "sync":
        # Never "fork": copies of processes with threads (torch) may deadlock.
        settings["context"] = "spawn"
        if "forkserver" in multiprocessing.get_all_start_methods():
            settings["context"] = "forkserver"
            multiprocessing.set_forkserver_preload(["lidarnaut.envs.vector"])
    if mode != "native":
        may_end = spec.max_episode_steps or spec.additional_wrappers or not isinstance(entry, type)
        return gymnasium.make_vec(spec, num_envs, mode, settings, [LastInfo] * bool(may_end), **arguments)
    settings["num_workers"] = config.num_workers
    if spec.vector_entry_point is not None:
        return gymnasium.make_vec(spec, num_envs, "vector_entry_point", **settings, **arguments)
    settings["max_episode_steps"] = spec.max_episode_steps
    return LidarVectorEnv(partial(_make, entry), num_envs, **settings, **{**spec.kwargs, **arguments})


def make_vec_env(config: TrainingConfig, *, is_flat: bool = False) -> "GymnasiumVecEnv | JoinedVecEnv":
    """Create the training environments; each training robot drives in an equal share of them.

    `is_flat`: flatten dictionary observations to vectors. Raises ValueError if the configuration is invalid,
    sub-environments are too few, or spaces differ.
    """
    each = config.environment.each_robot
    bounds = np.linspace(0, config.num_envs, len(each) + 1).round().astype(int)
    if len(each) > config.num_envs:
        raise ValueError(f"num_envs is {config.num_envs}, fewer than the {len(each)} robots of environment.robots")
    with contextlib.ExitStack() as made:
        vectors: list[VectorEnv] = []
        for one, count in zip(each, np.diff(bounds).tolist()):
            vectors.append(made.enter_context(contextlib.closing(make_vector(one, "train", count))))
            if vectors[-1].single_observation_space != vectors[0].single_observation_space:
                raise ValueError(f"robot {one.robots[0]!r} of environment.robots has observations unlike the first")
        envs = [GymnasiumVecEnv(vector, is_flat=is_flat) for vector in vectors]
        made.pop_all()
    return JoinedVecEnv(envs) if len(envs) > 1 else envs[0]


def _arguments(config: EnvironmentConfig, split: Split) -> dict[str, Any]:
    accepted, arguments = arguments_of(config.id), config.arguments
    if unknown := [name for name in arguments if name not in accepted]:
        raise ValueError(f"environment: {config.id} has no argument {explain_unknown(unknown[0], accepted)}")
    usual = {"split": split, "physics": "kinematic"}
    return {name: value for name, value in usual.items() if name in accepted} | arguments


def columns_of(info: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return the entries of `info` that are arrays with one value per sub-environment."""
    return {name: value for name, value in info.items() if name[0] != "_" and isinstance(value, np.ndarray)}


class GymnasiumVecEnv(VecEnv):
    """Adapter from a Gymnasium vector environment with same-step autoreset to stable-baselines3.

    Sub-environment i gets seed + i. `infos` are filled only for finished episodes, as by `Monitor`.
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
        self._observations, _ = self.env.reset(seed=seeds, options=self._options[0] or None)
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
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(dones).tolist():
            infos[i] = self._end_of_episode(info, i) | {"TimeLimit.truncated": bool(truncated[i] and not terminated[i])}
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
        if len(chosen) < self.num_envs:
            raise ValueError(f"{method_name} can be called in all sub-environments, not in {chosen} alone")
        inner: Any = self.env.unwrapped
        return list(inner.call(method_name, *args, **kwargs))

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None) -> list[bool]:
        return [issubclass(wrapper_class, Monitor) for _ in self._get_indices(indices)]

    def _shown(self, observations: Observations) -> Any:
        return flatten(observations) if self._is_flat else observations

    def _end_of_episode(self, info: dict[str, Any], i: int) -> dict[str, Any]:
        final = {name: np.asarray(value[i]) for name, value in columns_of(info["final_info"]).items()}
        episode = {name: float(value.sum()) for name, value in final.items() if value.dtype.kind in "biuf"}
        episode |= {"r": float(self._returns[i]), "l": int(self._lengths[i])}
        self._returns[i] = self._lengths[i] = 0
        last = info["final_obs"][i]
        last = flatten({name: part[None] for name, part in last.items()})[0] if self._is_flat else last
        ended = {"episode": episode, "terminal_observation": last}
        return ended | ({"is_success": bool(final["is_success"])} if "is_success" in final else {})


class JoinedVecEnv(VecEnv):
    """Combines vector environments with equal spaces into one. Their worker processes step at the same time."""

    def __init__(self, envs: Sequence[GymnasiumVecEnv]) -> None:
        self._envs, self.parts = envs, envs[0].parts
        self._firsts = np.cumsum([0, *(env.num_envs for env in envs)])
        super().__init__(int(self._firsts[-1]), envs[0].observation_space, envs[0].action_space)

    def reset(self) -> Any:
        for env, first in zip(self._envs, self._firsts):
            env.seed(self._seeds[first])
            env.set_options(self._options[first])
        self._reset_seeds()
        self._reset_options()
        return self._concatenate([env.reset() for env in self._envs])

    def step_async(self, actions: np.ndarray) -> None:
        for env, share in zip(self._envs, np.split(actions, self._firsts[1:-1])):
            env.step_async(share)

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observations, rewards, dones, infos = zip(*(env.step_wait() for env in self._envs))
        return self._concatenate(observations), np.concatenate(rewards), np.concatenate(dones), [*chain(*infos)]

    def close(self) -> None:
        for env in self._envs:
            env.close()

    def get_images(self) -> list[np.ndarray | None]:
        return [*chain(*(env.get_images() for env in self._envs))]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [*chain(*(env.get_attr(attr_name, own) for env, own in self._shares(indices)))]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        for env, own in self._shares(indices):
            env.set_attr(attr_name, value, own)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        return [
            *chain(*(env.env_method(method_name, *args, indices=own, **kwargs) for env, own in self._shares(indices)))
        ]

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None) -> list[bool]:
        return [*chain(*(env.env_is_wrapped(wrapper_class, own) for env, own in self._shares(indices)))]

    def _shares(self, indices: Any) -> Iterator[tuple[GymnasiumVecEnv, list[int]]]:
        chosen = np.sort(list(self._get_indices(indices)))
        for env, first in zip(self._envs, self._firsts):
            own = chosen[(chosen >= first) & (chosen < first + env.num_envs)] - first
            if len(own):
                yield env, own.tolist()

    def _concatenate(self, observations: Sequence[Any]) -> Any:
        if not isinstance(observations[0], dict):
            return np.concatenate(observations)
        return {name: np.concatenate([one[name] for one in observations]) for name in observations[0]}
