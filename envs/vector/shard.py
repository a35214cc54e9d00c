"""Sub-environments stepped by one process."""

import contextlib
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from lidarnaut.envs.columns import Extras, Memory, Records, parts_of, whole_of
from lidarnaut.envs.core import LidarEnv, lidar_env_of
from lidarnaut.envs.overrides import overridden
from lidarnaut.envs.period import Batch

_preparing = threading.Lock()
"""Lock that prevents forks of the process while a thread samples the next world."""
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_preparing.acquire, after_in_parent=_preparing.release, after_in_child=_preparing.release
    )


class Shard:
    """Sub-environments of one process. A thread samples their next worlds."""

    def __init__(
        self,
        make_env: Callable[[], Any],
        memory: Memory,
        share: slice,
        autoreset_mode: AutoresetMode,
        max_episode_steps: int | None,
    ) -> None:
        """Create the sub-environments of one process. `share`: their indices among all sub-environments."""
        self.envs = [make_env() for _ in range(share.stop - share.start)]
        self._inner = [env.unwrapped for env in self.envs]
        for env in self._inner:  # separate spaces would each store pixel bounds
            env.observation_space = self._inner[0].observation_space
        self._arrays = arrays = memory.arrays().rows(share)
        self._mode = autoreset_mode
        self._max_steps = max_episode_steps
        self._is_own = np.array([is_own(env) for env in self.envs])
        self._rows = [{name: array[i] for name, array in arrays.observations.items()} for i in range(len(self.envs))]
        self._steps = np.zeros(len(self.envs), dtype=np.int64)
        self._has_ended = np.zeros(len(self.envs), dtype=np.bool_)
        self._preparer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="worlds")
        self._preparations: list[Future[None] | None] = [None] * len(self.envs)
        self._records = Records(len(self.envs), ())
        self._batch: Batch | None = None

    def reset(
        self, seeds: Sequence[int | None], mask: Sequence[bool], options: dict[str, Any] | None
    ) -> tuple[np.ndarray, Extras]:
        """Start episodes in the sub-environments selected by `mask`, and return their `info`.

        Returns a structured array, shape (num_envs,), zero for unselected sub-environments; and dictionaries of the
        `info` entries that do not fit into it.
        """
        self._records.extras = {}
        for i, seed in enumerate(seeds):
            if mask[i]:
                self._records.note(i, self._reset(i, seed, options))
                self._arrays.terminated[i] = self._arrays.truncated[i] = False
        self._bind(range(len(self.envs)))
        rows = self._records.rows
        return np.where(mask, rows, np.zeros_like(rows)), self._records.extras

    def fix_kinds(self, kinds: Sequence[tuple[str, Any]]) -> None:
        """Set the `info` entries (name, NumPy type) that a structured array stores; dictionaries store all others."""
        first, self._records = self._records.extras, Records(len(self.envs), kinds)
        for i, info in first.items():
            self._records.note(i, info)
        self._bind(range(len(self.envs)))

    def step(self) -> tuple[np.ndarray, Extras]:
        """Step every sub-environment, and return `info`: a structured array, and dictionaries of further entries."""
        arrays, records, ended = self._arrays, self._records, self._has_ended.copy()
        records.extras = {}
        self._steps += ~ended
        is_last, is_left = self._steps == self._max_steps, np.ones_like(ended)
        if self._batch is not None and not ended.all():
            is_left = ended | self._batch.step(~ended, is_last, records)
            arrays.terminated[:] = arrays.truncated[:] = False
        for i in np.flatnonzero(is_left).tolist():
            if ended[i]:
                reward, terminated, truncated, info = 0.0, False, False, self._reset(i, None, None)
            else:
                reward, terminated, truncated, info = self._outcome(i, bool(is_last[i]))
            arrays.rewards[i], arrays.terminated[i], arrays.truncated[i] = reward, terminated, truncated
            if (terminated or truncated) and self._mode == AutoresetMode.SAME_STEP:
                final = whole_of({name: row.copy() for name, row in self._rows[i].items()})
                records.extras[i] = {"final_obs": final, "final_info": info}
                info = self._reset(i, None, None)
            elif terminated or truncated:
                self._has_ended[i] = True
            records.note(i, info)
        return records.rows, records.extras

    def _outcome(self, i: int, is_last: bool) -> tuple[float, bool, bool, dict[str, Any]]:
        env, action = self.envs[i], self._arrays.actions[i].copy()  # wrappers may keep it
        if self._is_own[i]:
            observation, reward, terminated, truncated, info = env.step(action)
            self._write(i, observation)
            if is_last and not (terminated or truncated):  # as `judge` does
                info, truncated = {**info, **lidar_env_of(env).final_metrics(), "end_reason": "time_limit"}, True
            return reward, terminated, truncated, info
        if self._batch is None:
            env.apply(action)
            env.observe(self._rows[i])
        return env.outcome(is_last)

    def call(self, name: str, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> list[Any]:
        with self._objects():
            found = [env.get_wrapper_attr(name) for env in self.envs]
            return [value(*args, **kwargs) if callable(value) else value for value in found]

    def set_attr(self, name: str, values: Sequence[Any]) -> None:
        with self._objects():
            for env, value in zip(self.envs, values, strict=True):
                env.set_wrapper_attr(name, value)

    @contextlib.contextmanager
    def _objects(self) -> Iterator[None]:
        if self._batch is not None:
            self._batch.catch_up()
        try:
            yield
        finally:  # also after an error
            self._bind(range(len(self.envs)))

    def close(self) -> None:
        self._preparer.shutdown(wait=True, cancel_futures=True)
        for env in self.envs:
            env.close()

    def _reset(self, i: int, seed: int | None, options: dict[str, Any] | None) -> dict[str, Any]:
        env, preparation = self.envs[i], self._preparations[i]
        if preparation is not None and not preparation.cancel():
            with _preparing:  # not `wait`: a forked process lacks the thread
                pass
        observation, info = env.reset(seed=seed, options=options)
        self._write(i, observation)
        self._steps[i], self._has_ended[i] = 0, False
        self._preparations[i] = self._preparer.submit(_prepare, self._inner[i])
        if self._batch is not None:
            self._bind([i])
        return info

    def _write(self, i: int, observation: Any) -> None:
        parts = parts_of(observation)
        for name, row in self._rows[i].items():
            row[...] = parts[name]

    def _bind(self, indices: Sequence[int]) -> None:
        self._is_own[indices] = [is_own(self.envs[i]) for i in indices]
        if not self._records.kinds:
            return
        changed = [self.envs[i] for i in (range(len(self.envs)) if self._batch is None else indices)]
        if self._is_own.any() or not all(isinstance(env, LidarEnv) and not env.why_not_fused for env in changed):
            self._batch = None
            return
        if self._batch is None:
            self._batch, indices = Batch(self.envs, self._arrays), range(len(self.envs))
        self._batch.bind(indices)


def is_own(env: Any) -> bool:
    """Return True if an environment has wrappers or overridden methods, so that only its own `step` may step it."""
    return env is not env.unwrapped or bool(overridden(env))


def _prepare(env: Any) -> None:
    with _preparing, contextlib.suppress(Exception):
        env.prepare()
