"""A share of a vector environment's sub-environments, stepped one after the other in one process."""

import os
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from .memory import Arrays, record_type, to_record

_preparing = threading.Lock()
"""Held while a thread prepares an episode, and by whoever forks: a forked process would get the locks that the thread
holds then, the compiler's for example, without the thread that releases them."""
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_preparing.acquire, after_in_parent=_preparing.release, after_in_child=_preparing.release
    )

Extras = dict[int, dict[str, Any]]
"""By sub-environment: what `info` holds only now and then, such as `end_reason`, `final_obs` and `final_info`."""


class Shard:
    """Sub-environments in this process.

    Worlds of coming episodes are drawn ahead of time in a thread.
    """

    def __init__(
        self,
        envs: Sequence[Any],
        arrays: Arrays,
        autoreset_mode: AutoresetMode,
        max_episode_steps: int | None,
    ) -> None:
        """Take the sub-environments.

        Args:
            envs: at least one; see `envs.core.LidarEnv` for what a shard calls.
            arrays: their rows.
            autoreset_mode: when a sub-environment whose episode has ended starts the next one.
            max_episode_steps: truncates episodes after so many steps.
        """
        self._arrays = arrays
        self._mode = autoreset_mode
        self._max_steps = max_episode_steps
        self.envs = envs
        for env in self.envs:  # each would hold bounds of its own for every pixel
            env.observation_space = self.envs[0].observation_space
        self._rows = [{name: array[i] for name, array in arrays.observations.items()} for i in range(len(self.envs))]
        self._steps = [0] * len(self.envs)
        self._has_ended = [False] * len(self.envs)
        self._preparer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="worlds")
        self._preparations: list[Future[None] | None] = [None] * len(self.envs)
        self._records: np.ndarray | None = None

    def reset(
        self, seeds: Sequence[int | None], mask: Sequence[bool], options: dict[str, Any] | None
    ) -> tuple[np.ndarray, Extras]:
        """Start episodes.

        Args:
            seeds: one for each sub-environment.
            mask: which of them to reset.
            options: of their `reset`.

        Returns:
            What `info` holds at every step, a record for each sub-environment, and extras.
        """
        extras: Extras = {}
        for i, seed in enumerate(seeds):
            if mask[i]:
                self._note(i, self._reset(i, seed, options), extras)
                self._arrays.terminated[i] = self._arrays.truncated[i] = False
        assert self._records is not None
        return self._records, extras

    def step(self) -> tuple[np.ndarray, Extras]:
        """Step every sub-environment with its row of the actions; returns as `reset`."""
        assert self._records is not None
        arrays, extras = self._arrays, Extras()
        for i, env in enumerate(self.envs):
            if self._has_ended[i]:
                info = self._reset(i, None, None)
                arrays.rewards[i], arrays.terminated[i], arrays.truncated[i] = 0.0, False, False
                self._note(i, info, extras)
                continue
            self._steps[i] += 1
            env.apply(arrays.actions[i])
            env.observe(self._rows[i])
            reward, terminated, truncated, info = env.outcome(self._steps[i] == self._max_steps)
            arrays.rewards[i], arrays.terminated[i], arrays.truncated[i] = reward, terminated, truncated
            if terminated or truncated:
                self._close_episode(i, info, extras)
            else:
                self._note(i, info, extras)
        return self._records, extras

    def call(self, name: str, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> list[Any]:
        """Call a method of every sub-environment, or return an attribute that is none."""
        found = [getattr(env, name) for env in self.envs]
        return [value(*args, **kwargs) if callable(value) else value for value in found]

    def set_attr(self, name: str, values: Sequence[Any]) -> None:
        """Set an attribute of every sub-environment."""
        for env, value in zip(self.envs, values, strict=True):
            setattr(env, name, value)

    def close(self) -> None:
        """Close the sub-environments."""
        self._preparer.shutdown(wait=True, cancel_futures=True)
        for env in self.envs:
            env.close()

    def _reset(self, i: int, seed: int | None, options: dict[str, Any] | None) -> dict[str, Any]:
        """Start an episode and return its first info."""
        env, preparation = self.envs[i], self._preparations[i]
        if preparation is not None:
            preparation.result()
        observation, info = env.reset(seed=seed, options=options)
        for name, row in self._rows[i].items():
            row[...] = observation[name]
        self._steps[i], self._has_ended[i] = 0, False
        self._preparations[i] = self._preparer.submit(_prepare, env)
        return info

    def _close_episode(self, i: int, info: dict[str, Any], extras: Extras) -> None:
        """Take note of an episode's last info, and start the next one where that is due at once."""
        if self._mode == AutoresetMode.SAME_STEP:
            final = {name: row.copy() for name, row in self._rows[i].items()}
            extras[i] = {"final_obs": final, "final_info": info}
            info = self._reset(i, None, None)
        else:
            self._has_ended[i] = True
        self._note(i, info, extras)

    def _note(self, i: int, info: dict[str, Any], extras: Extras) -> None:
        """Write to the records what `info` holds at every step, and to the extras what else it holds."""
        if self._records is None:
            self._dtype = record_type(info)
            self._records = np.zeros(len(self.envs), self._dtype)
        self._records[i] = to_record(info, self._dtype)
        names = self._dtype.names or ()
        if len(info) > len(names):
            extras[i] = {name: info[name] for name in info if name not in names} | extras.get(i, {})


def _prepare(env: Any) -> None:
    with _preparing:
        env.prepare()


def make_shard(make_env, memory, first, last, autoreset_mode, max_episode_steps):
    return Shard([make_env() for _ in range(last - first)], memory.arrays().rows(first, last), autoreset_mode, max_episode_steps)
