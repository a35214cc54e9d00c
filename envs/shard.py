"""A share of a vector environment's sub-environments, stepped one after the other in one process."""

import ctypes
import math
import os
import pickle
import select
import signal
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

ALIGNMENT = 64
"""Arrays begin at multiples of a cache line [bytes]."""
PATIENCE = 0.002
"""How long a process waits for the others before it sleeps [s]."""

_preparing = threading.Lock()
"""Held while a thread prepares an episode, and by whoever forks: a forked process would get the locks that the thread
holds then, the compiler's for example, without the thread that releases them."""
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_preparing.acquire, after_in_parent=_preparing.release, after_in_child=_preparing.release
    )

Extras = dict[int, dict[str, Any]]
"""By sub-environment: what `info` holds only now and then, such as `end_reason`, `final_obs` and `final_info`."""


class Arrays(NamedTuple):
    """What sub-environments read and write in place, one row each."""

    observations: dict[str, np.ndarray]
    """Shape (num_envs, ...) each."""
    actions: np.ndarray
    """Shape (num_envs, ...)."""
    rewards: np.ndarray
    """Shape (num_envs,), float64."""
    terminated: np.ndarray
    """Shape (num_envs,), bool."""
    truncated: np.ndarray
    """Shape (num_envs,), bool."""

    def rows(self, first: int, last: int) -> "Arrays":
        """Return the rows from `first` to `last` - 1."""
        observations = {name: array[first:last] for name, array in self.observations.items()}
        return Arrays(observations, *(array[first:last] for array in self[1:]))


class Memory(NamedTuple):
    """Memory that processes may share, and which array lies where in it. Pickling does not copy it, unlike arrays."""

    buffer: Any
    """A `multiprocessing.RawArray` of bytes, or a bytearray of one process."""
    names: tuple[str, ...]
    """Of the observations' arrays, which come first."""
    layout: tuple[tuple[int, tuple[int, ...], np.dtype], ...]
    """Offset [bytes], shape and type of each array."""

    @classmethod
    def of(cls, num_envs: int, observations: spaces.Dict, actions: spaces.Space, context: Any = None) -> "Memory":
        """Return memory for the arrays of so many sub-environments.

        Args:
            num_envs: number of sub-environments.
            observations: space of one observation.
            actions: space of one action.
            context: `multiprocessing` context of the processes that share it; None for this process alone.
        """
        rows: list[tuple[Any, Any]] = [(space.shape, space.dtype) for space in (*observations.values(), actions)]
        rows += [((), np.float64), ((), np.bool_), ((), np.bool_)]
        layout, size = [], 0
        for shape, kind in rows:
            dtype = np.dtype(kind)
            layout.append((size, (num_envs, *shape), dtype))
            size += -(-math.prod((num_envs, *shape)) * dtype.itemsize // ALIGNMENT) * ALIGNMENT
        buffer = bytearray(size) if context is None else context.RawArray(ctypes.c_uint8, size)
        return cls(buffer, tuple(observations), tuple(layout))

    def arrays(self) -> Arrays:
        """Return the arrays, which show this memory."""
        views = [
            np.frombuffer(self.buffer, dtype, math.prod(shape), offset).reshape(shape)
            for offset, shape, dtype in self.layout
        ]
        return Arrays(dict(zip(self.names, views, strict=False)), *views[len(self.names) :])


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


def record_type(info: Mapping[str, Any]) -> np.dtype:
    """Return the type of records that hold an info dict: numbers, texts, arrays, and dicts of them."""
    fields: list[Any] = []
    for name, value in info.items():
        if isinstance(value, Mapping):
            fields.append((name, record_type(value)))
        elif isinstance(value, str):
            fields.append((name, "U32"))
        else:
            array = np.asarray(value)
            fields.append((name, array.dtype, array.shape))
    return np.dtype(fields)


def to_record(info: Mapping[str, Any], dtype: np.dtype) -> tuple[Any, ...]:
    """Return an info dict as what is assigned to a record."""
    values = []
    for name in dtype.names or ():
        value = info[name]
        values.append(to_record(value, dtype[name]) if isinstance(value, dict) else value)
    return tuple(values)


def wait(pipe: Connection) -> None:
    """Wait for a message for a while without sleeping: to be woken takes as long as a robot takes for its step."""
    if not hasattr(select, "poll"):  # Windows
        return
    poll = select.poll()
    poll.register(pipe.fileno(), select.POLLIN)
    end = time.perf_counter() + PATIENCE
    while not poll.poll(0) and time.perf_counter() < end:
        pass


def serve(pipe: Connection, make_shard: Callable[[], Shard]) -> None:
    """Answer a vector environment's calls until it sends b"q" or closes the pipe; what a worker process runs.

    Each answer is one byte, "." for a step without extras, "+" for a pickled result, "!" for an error, and its bytes.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent closes its workers.
    shard: Shard | None = None
    while True:
        try:
            wait(pipe)
            request = pipe.recv_bytes()
        except (EOFError, ConnectionResetError):
            break
        if request == b"q":
            break
        try:
            shard = shard or make_shard()
            if request == b"s":
                records, extras = shard.step()
                answer = b"+" + pickle.dumps((records, extras)) if extras else b"." + records.tobytes()
            else:
                method, args = pickle.loads(request)
                answer = b"+" + pickle.dumps(getattr(shard, method)(*args) if method else None)
        except Exception as error:
            error.add_note(f"in a worker process:\n{traceback.format_exc()}")
            answer = b"!" + _dump_error(error)
        pipe.send_bytes(answer)
    if shard is not None:
        shard.close()


def _dump_error(error: Exception) -> bytes:
    try:
        return pickle.dumps(error)
    except Exception:
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
