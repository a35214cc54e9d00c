"""Vector environments of Gymnasium as stable-baselines3 wants them."""

from typing import Any, NoReturn

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from agents.vector import Observations


class GymnasiumVecEnv(VecEnv):
    """Adapts a Gymnasium vector environment that resets lanes in the same step: native lanes, sync or async.

    Lane i is seeded with seed + i, whatever runs it. `infos` are filled for lanes whose episode ended, and empty for
    all others: stable-baselines3 looks at nothing else.
    """

    def __init__(self, env: gymnasium.vector.VectorEnv) -> None:
        """Wrap `env`.

        Raises:
            ValueError: if it does not reset lanes in the step that ends their episode.
        """
        if env.metadata.get("autoreset_mode") != AutoresetMode.SAME_STEP:
            raise ValueError(
                "stable-baselines3 needs autoreset_mode=AutoresetMode.SAME_STEP, "
                f"got {env.metadata.get('autoreset_mode')}"
            )
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)

    def reset(self) -> Observations:
        """Start an episode in every lane, with the seeds of the last call of `seed`."""
        observations, _ = self.env.reset(seed=self._seeds)  # type: ignore[arg-type]  # one per lane is allowed
        self._reset_seeds()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observations, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step every lane."""
        observations, rewards, terminated, truncated, info = self.env.step(self._actions)
        self._returns += rewards
        self._lengths += 1
        dones = np.asarray(terminated) | np.asarray(truncated)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for lane in np.flatnonzero(dones).tolist():
            infos[lane] = self._end_of_episode(info, lane, bool(truncated[lane] and not terminated[lane]))
        return observations, rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return the environment's attribute, once per lane."""
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None) -> list[bool]:
        """Return False: episodes are counted by the environment, no wrapper is needed."""
        return [False] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse."""
        self._refuse()

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refuse."""
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise NotImplementedError("lanes are rows of arrays and no objects; reach into them through `env`")

    def _end_of_episode(self, info: dict[str, Any], lane: int, cut_short: bool) -> dict[str, Any]:
        """Return what stable-baselines3 and its callbacks look for in a lane whose episode ended."""
        final = info["final_info"]
        episode = {"r": float(self._returns[lane]), "l": int(self._lengths[lane])}
        for name in ("explored_fraction", "collisions"):
            episode[name] = float(final[name][lane])
        self._returns[lane] = 0.0
        self._lengths[lane] = 0
        return {
            "episode": episode,
            "is_success": bool(final["is_success"][lane]),
            "terminal_observation": info["final_obs"][lane],
            "TimeLimit.truncated": cut_short,
        }
