"""The environments of an experiment, and vector environments of Gymnasium adapted to stable-baselines3."""

import multiprocessing
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

import envs  # noqa: F401  (registers the environments)
from agents.config import EnvironmentConfig

Observations = dict[str, np.ndarray]
"""Observations of several environments, stacked along axis 0."""
EPISODE_MEASURES = ("explored_fraction", "collisions", "time")
"""Numbers of the last `info` that go into `infos[i]["episode"]`, where the environment has them."""


def make_env(config: EnvironmentConfig, split: Literal["train", "test"]) -> gymnasium.Env:
    """Make one environment on the worlds of a split."""
    return gymnasium.make(config.id, split=split, **config.arguments)


def make_vector(
    config: EnvironmentConfig, split: Literal["train", "test"], num_envs: int
) -> VectorEnv[Observations, np.ndarray, np.ndarray]:
    """Make several environments on the worlds of a split. One whose episode ends starts the next at once.

    Raises:
        ValueError: if an argument is not allowed, or the environment has no such arguments.
    """
    arguments = {**config.arguments, "split": split}
    settings: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
    if config.vectorization != "sync":
        # Never "fork": torch has threads, and a copy of a process whose threads are gone may hang.
        methods = multiprocessing.get_all_start_methods()
        settings["context"] = "forkserver" if "forkserver" in methods else "spawn"
    if config.vectorization == "native":
        settings["num_workers"] = config.num_workers
        mode: dict[str, Any] = {"vectorization_mode": "vector_entry_point", **settings}
    else:
        mode = {"vectorization_mode": config.vectorization, "vector_kwargs": settings}
    try:
        return gymnasium.make_vec(config.id, num_envs, **mode, **arguments)
    except TypeError as error:
        if "unexpected keyword argument" not in str(error):
            raise
        raise ValueError(f"environment.id: {config.id!r} is not for exploration: {error}") from error


class GymnasiumVecEnv(VecEnv):
    """Adapts a Gymnasium vector environment that resets a sub-environment in the step that ends its episode.

    Sub-environment i is seeded with seed + i. `infos` are filled for those whose episode ended (as by `Monitor`), and
    empty for all others: stable-baselines3 looks at nothing else. `env_method`, `get_attr` and `set_attr` reach the
    sub-environments through Gymnasium's `call`, `get_attr` and `set_attr`; where observations hold an `action_mask`,
    `env_method("action_masks")` is answered from the latest ones, so that masking costs nothing.
    """

    def __init__(self, env: VectorEnv, *, clip_actions: bool = False) -> None:
        """Wrap `env`.

        Args:
            env: made with `autoreset_mode=AutoresetMode.SAME_STEP`.
            clip_actions: whether actions outside a `Box` are cut to its bounds; otherwise the environment refuses them.
                Algorithms of stable-baselines3 clip what a Gaussian draws before they step; others may not.

        Raises:
            ValueError: if `env` has another autoreset mode.
        """
        mode = env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f"stable-baselines3 needs autoreset_mode=AutoresetMode.SAME_STEP, got {mode}")
        self.env = env
        self._observations: Observations = {}
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._clips = clip_actions and isinstance(env.single_action_space, spaces.Box)
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)

    def reset(self) -> Observations:
        """Start an episode in every sub-environment, with the seeds and options that `seed` and `set_options` gave.

        Raises:
            ValueError: if the options differ between sub-environments.
        """
        if any(options != self._options[0] for options in self._options):
            raise ValueError("options must be the same for all sub-environments")
        seeds: Any = self._seeds
        self._observations, _ = self.env.reset(seed=seeds, options=self._options[0] or None)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return self._observations

    def step_async(self, actions: np.ndarray) -> None:
        space = self.action_space
        self._actions = np.clip(actions, space.low, space.high) if self._clips else actions  # type: ignore[attr-defined]

    def step_wait(self) -> tuple[Observations, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        self._observations, rewards, terminated, truncated, info = self.env.step(self._actions)
        self._returns += rewards
        self._lengths += 1
        dones = np.asarray(terminated) | np.asarray(truncated)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(dones).tolist():
            infos[i] = self._end_of_episode(info, i, bool(truncated[i] and not terminated[i]))
        return self._observations, rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        self.env.close()

    def get_images(self) -> list[np.ndarray | None]:
        pictures: Any = self.env.render()
        return list(pictures or [None] * self.num_envs)

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the sub-environments.

        Raises:
            AttributeError: if they do not have it.
        """
        if attr_name == "action_masks" and self._has_masks:
            return [None] * len(list(self._get_indices(indices)))  # only asked whether there is one
        inner, size = self.env.unwrapped, self.num_envs
        values = inner.get_attr(attr_name) if hasattr(inner, "get_attr") else [getattr(inner, attr_name)] * size
        return [values[i] for i in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the sub-environments to one value."""
        inner: Any = self.env.unwrapped
        chosen = set(self._get_indices(indices))
        values = [value] * self.num_envs if len(chosen) == self.num_envs else list(inner.get_attr(attr_name))
        inner.set_attr(attr_name, [value if i in chosen else values[i] for i in range(self.num_envs)])

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method of the sub-environments.

        Raises:
            ValueError: if it is to be called in some of them only.
        """
        chosen = list(self._get_indices(indices))
        if method_name == "action_masks" and self._has_masks:
            masks = self._observations["action_mask"].astype(np.bool_)
            return [masks[i] for i in chosen]
        if len(chosen) < self.num_envs:
            raise ValueError(f"{method_name} can be called in all sub-environments, not in {chosen} alone")
        inner: Any = self.env.unwrapped
        return list(inner.call(method_name, *args, **kwargs))

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None) -> list[bool]:
        """Return whether `infos` hold what a wrapper would add: those of `Monitor` are there, no others."""
        return [issubclass(wrapper_class, Monitor)] * len(list(self._get_indices(indices)))

    @property
    def _has_masks(self) -> bool:
        space = self.env.single_observation_space
        return isinstance(space, spaces.Dict) and "action_mask" in space.spaces

    def _end_of_episode(self, info: dict[str, Any], i: int, cut_short: bool) -> dict[str, Any]:
        """Return what stable-baselines3 and its callbacks look for where the episode of sub-environment i ended."""
        final = info["final_info"]
        episode = {"r": float(self._returns[i]), "l": int(self._lengths[i])}
        episode |= {name: float(final[name][i]) for name in EPISODE_MEASURES if name in final}
        self._returns[i] = 0.0
        self._lengths[i] = 0
        ended = {"episode": episode, "terminal_observation": info["final_obs"][i], "TimeLimit.truncated": cut_short}
        return ended | ({"is_success": bool(final["is_success"][i])} if "is_success" in final else {})
