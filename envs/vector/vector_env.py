"""Vector environment with worker processes and shared memory."""

import contextlib
import functools
import itertools
import multiprocessing
import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from lidarnaut.envs.arguments import clip_hint, is_whole, read_action, read_options
from lidarnaut.envs.columns import Absent, Extras, Memory, from_record, kinds_of, whole_of
from lidarnaut.envs.processes import interrupts_delayed, num_cores

from .shard import Shard, is_own
from .workers import Worker

MAX_ENVS = 100_000


class LidarVectorEnv(gymnasium.vector.VectorEnv[dict[str, np.ndarray], np.ndarray, np.ndarray]):
    """Vector environment of lidar robots, with worker processes.

    Sub-environment i behaves as a single environment with seed + i. Each step returns new observation arrays. `info`
    holds arrays with masks, as in Gymnasium.
    """

    def __init__(
        self,
        make_env: Callable[..., Any],
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        num_workers: int | None = None,
        context: str | None = None,
        env_wrappers: Sequence[Callable[[Any], Any]] = (),
        variants: Sequence[Mapping[str, Any]] = ({},),
        **arguments: Any,
    ) -> None:
        """Create the sub-environments and start the worker processes.

        Args:
            make_env: class of the sub-environments, such as `LidarEnv`.
            num_envs: number of sub-environments.
            autoreset_mode: reset after an episode in the next step (`NEXT_STEP`), in the same step (`SAME_STEP`), or by
                `reset` with a `reset_mask` (`DISABLED`).
            max_episode_steps: steps until truncation, besides the time limit; None or -1 for no limit.
            num_workers: number of processes, including the current one; 0 equals 1, None is the number of available
                cores.
            context: start method, "fork", "forkserver" or "spawn"; None for Python's default.
            env_wrappers: wrappers of each sub-environment, innermost first; called `wrappers` by `make_vec`.
            variants: further arguments of consecutive equal shares of the sub-environments, such as
                `[{"robot": "turtlebot3_burger"}, {"robot": "turtlebot3_waffle_pi"}]`.
            **arguments: arguments of all sub-environments.

        Raises:
            ValueError: an argument is not allowed, or spaces of variants differ.
        """
        self.closed = True  # until the workers have started
        _check(num_envs, num_workers, max_episode_steps, variants, arguments.get("render_mode"))
        self.num_envs = num_envs = int(num_envs)
        num_workers = max(min(num_cores() if num_workers is None else num_workers, num_envs), 1)
        max_episode_steps = None if max_episode_steps == -1 else max_episode_steps  # as in `gymnasium.make`
        autoreset_mode = AutoresetMode(autoreset_mode)
        make_one = functools.partial(_make, make_env, tuple(env_wrappers), max_episode_steps)
        makers = [functools.partial(make_one, {**arguments, **variant}) for variant in variants]
        with contextlib.closing(makers[0]()) as env:
            self._take_spaces(env, autoreset_mode)
        for variant, make_other in zip(variants[1:], makers[1:], strict=True):
            with contextlib.closing(make_other()) as other:
                if (other.observation_space, other.action_space) != (env.observation_space, env.action_space):
                    raise ValueError(f"variants: {variant} has observations or actions unlike {variants[0]}")
        self._dtype: np.dtype | None = None
        self._owner = os.getpid()
        self._has_begun = self._is_under_way = False
        how = autoreset_mode, max_episode_steps
        self._start(makers, num_workers, multiprocessing.get_context(context), how)
        self.closed = False

    def _start(self, makers: Sequence[Any], num_workers: int, context: Any, how: tuple[AutoresetMode, Any]) -> None:
        spaces_of_one = self.single_observation_space, self.single_action_space
        memory = Memory(self.num_envs, *spaces_of_one, context if num_workers > 1 else None)
        self._arrays = memory.arrays()
        self._shares: list[slice] = []
        self._shares_of: list[list[int]] = [[] for _ in range(num_workers)]
        shards: list[list[Callable[[], Shard]]] = [[] for _ in range(num_workers)]
        for make_one, process, share in _split(makers, self.num_envs, num_workers):
            shards[process].append(functools.partial(Shard, make_one, memory, share, *how))
            self._shares_of[process].append(len(self._shares))
            self._shares.append(share)
        # This process steps the first shards itself.
        self._workers = [Worker(context, own) for own in shards[1:]]
        self._shards = [make_shard() for make_shard in shards[0]]

    def _take_spaces(self, env: Any, autoreset_mode: AutoresetMode) -> None:
        self.single_observation_space, self.single_action_space = env.observation_space, env.action_space
        self.observation_space = batch_space(env.observation_space, self.num_envs)
        self.action_space = batch_space(env.action_space, self.num_envs)
        self.metadata, self.render_mode = {**env.metadata, "autoreset_mode": autoreset_mode}, env.render_mode
        self._kind, self._is_own = type(env.unwrapped), is_own(env)
        self._clips_actions = getattr(env.unwrapped, "clip_actions", False)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        mode: AutoresetMode = self.metadata["autoreset_mode"]
        return mode

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start episodes in all or selected sub-environments.

        Args:
            seed: seed of sub-environment 0, seed + i for sub-environment i; or one seed each.
            options: options of `reset`; "reset_mask", shape (num_envs,), bool, selects sub-environments.

        Raises:
            ValueError: wrong number of seeds, or an empty mask.
            gymnasium.error.ResetNeeded: the mask excludes sub-environments without an episode.
            gymnasium.error.ClosedEnvironmentError, RuntimeError: after `close` or an interrupted call.
        """
        seeds: list[Any] = [None] * self.num_envs
        if is_whole(seed):
            seeds = [int(seed) + i for i in range(self.num_envs)]
        elif seed is not None:
            seeds = list(seed) if np.iterable(seed) else []
        if len(seeds) != self.num_envs or not all(one is None or is_whole(one) for one in seeds):
            raise ValueError(f"seed must be one whole number or {self.num_envs} of them, got {seed!r}")
        seeds = [None if one is None else int(one) for one in seeds]
        options = read_options(options)
        mask = np.asarray(options.pop("reset_mask", np.ones(self.num_envs, dtype=np.bool_)))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"reset_mask must have shape ({self.num_envs},), dtype bool and select a sub-environment")
        self._check_open()
        if not (self._has_begun or mask.all()):
            raise gymnasium.error.ResetNeeded("the first reset must start all sub-environments")
        self._has_begun = False  # unless all succeed
        shares = [(seeds[share], mask[share].tolist(), options or None) for share in self._shares]
        results = self._call("reset", shares)
        info = self._info(results, mask)
        if self._dtype is None:
            kinds = kinds_of(results[0][1].get(0, {}))
            self._call("fix_kinds", [(kinds,)] * len(self._shares))
            self._dtype = np.dtype(kinds)
        self._has_begun = True
        return self._observations(), info

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step every sub-environment with `actions`, shape (num_envs, ...).

        Raises:
            ValueError: wrong shape, or outside of the action space.
            gymnasium.error.ResetNeeded: no episode has begun, one has ended, or a step has failed.
            gymnasium.error.ClosedEnvironmentError, RuntimeError: after `close` or an interrupted call.
        """
        self.step_async(actions)
        return self.step_wait()

    def step_async(self, actions: np.ndarray) -> None:
        """Start a step in the worker processes; `step_wait` completes it. Raises the errors of `step`."""
        self._check_open()
        if not self._has_begun:
            raise gymnasium.error.ResetNeeded("call reset first: no episodes have begun, or a step has failed")
        arrays = self._arrays
        arrays.actions[...] = self._check_actions(actions)
        if self.autoreset_mode == AutoresetMode.DISABLED:
            ended = np.flatnonzero(arrays.terminated | arrays.truncated).tolist()
            if ended:
                raise gymnasium.error.ResetNeeded(f"sub-environments {ended} have ended; reset them with a reset_mask")
        self._has_begun = False  # unless all succeed
        with interrupts_delayed():
            self._send(itertools.repeat(b"s"))

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Complete a step; return the results of `step`. gymnasium.error.NoAsyncCallError without `step_async`."""
        if not self._is_under_way:
            raise gymnasium.error.NoAsyncCallError("call step_async before step_wait", "step_wait")
        with interrupts_delayed():
            results, arrays = self._receive("step", [()] * len(self._shares)), self._arrays
            self._has_begun = True
        info = self._info(results, np.ones(self.num_envs, dtype=np.bool_))
        return self._observations(), arrays.rewards.copy(), arrays.terminated.copy(), arrays.truncated.copy(), info

    def render(self) -> tuple[np.ndarray, ...] | None:
        return self.call("render") if self.render_mode is not None else None

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        self._check_open()
        return tuple(itertools.chain.from_iterable(self._call("call", [(name, args, kwargs)] * len(self._shares))))

    @property
    def np_random_seed(self) -> Any:
        return self.get_attr("np_random_seed")

    @property  # type: ignore[misc]
    def np_random(self) -> Any:
        return self.get_attr("np_random")

    def get_attr(self, name: str) -> tuple[Any, ...]:
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        values = list(values) if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(values) != self.num_envs:
            raise ValueError(f"values must be one value or a list of {self.num_envs}, got {len(values)}")
        self._check_open()
        self._call("set_attr", [(name, values[share]) for share in self._shares])

    def __getstate__(self) -> dict[str, Any]:
        reason = "a vector environment cannot be copied or pickled, since it has processes and threads"
        raise TypeError(f"{reason}; make another one with the same arguments")

    def close_extras(self, **kwargs: Any) -> None:
        for shard in self._shards:
            shard.close()
        for worker in self._workers if os.getpid() == self._owner else ():
            if self._is_under_way:  # it may be busy or wait for a message
                worker.process.kill()  # ignores inherited signal handlers
            worker.close()

    def _check_open(self) -> None:
        if self.closed:
            raise gymnasium.error.ClosedEnvironmentError("the vector environment is closed")
        if self._workers and os.getpid() != self._owner:
            raise RuntimeError("the workers of the vector environment belong to the process that forked this one")
        if self._is_under_way:
            raise RuntimeError("the vector environment was interrupted in a call; close it and make another one")

    def _check_actions(self, actions: Any) -> np.ndarray:
        space = self.single_action_space
        actions = read_action(actions)
        if actions.shape != (self.num_envs, *space.shape):  # type: ignore[misc]
            raise ValueError(f"actions must have shape {(self.num_envs, *space.shape)}, got {actions.shape}")  # type: ignore[misc]
        if self._is_own:  # it may have another action space
            return actions.astype(space.dtype, copy=False)
        if isinstance(space, spaces.Discrete):
            if not np.issubdtype(actions.dtype, np.integer):
                raise ValueError(f"actions must be integers, got {actions.dtype}")
            wrong, allowed = (actions < 0) | (actions >= space.n), f"lie in 0 to {space.n - 1}"
        else:
            actions = actions.astype(np.float32, copy=False)
            inside = ~np.isnan(actions) if self._clips_actions else np.abs(actions) <= 1.0
            wrong, allowed = ~inside.reshape(self.num_envs, -1).all(axis=1), "be finite and lie in [-1, 1]"
        if wrong.any():
            i = int(np.argmax(wrong))
            hint = clip_hint(self._kind, actions[i])
            raise ValueError(f"actions must {allowed}, got {actions[i]} in sub-environment {i}{hint}")
        return actions

    def _call(self, method: str, shares: Sequence[tuple[Any, ...]]) -> list[Any]:
        requests = [pickle.dumps((method, [shares[k] for k in own])) for own in self._shares_of[1:]]
        self._send(requests)  # after all are pickled
        return self._receive(method, shares)

    def _send(self, requests: Iterable[bytes]) -> None:
        self._is_under_way = True  # remains True after Ctrl-C
        for worker, request in zip(self._workers, requests, strict=False):
            worker.send(request)

    def _receive(self, method: str, shares: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Return one result per share, after this process has called the method of its own shards."""
        results: list[Any] = [None] * len(self._shares)
        answers: list[Any] = []
        try:
            answers.append([getattr(shard, method)(*shares[k]) for k, shard in zip(self._shares_of[0], self._shards)])
        except Exception as error:
            answers.append(error)
        answers += [worker.receive(self._dtype) for worker in self._workers]
        self._is_under_way = False
        for own, answer in zip(self._shares_of, answers, strict=True):
            if isinstance(answer, Exception):
                raise answer
            if isinstance(answer, np.ndarray):  # `info` without further entries
                lengths = [self._shares[k].stop - self._shares[k].start for k in own]
                answer = [(rows, {}) for rows in np.split(answer, np.cumsum(lengths)[:-1])]
            for k, result in zip(own, answer, strict=True):
                results[k] = result
        return results

    def _observations(self) -> Any:
        return whole_of({name: array.copy() for name, array in self._arrays.observations.items()})

    def _info(self, results: Sequence[tuple[np.ndarray, Extras]], mask: np.ndarray) -> dict[str, Any]:
        records = np.concatenate([records for records, _ in results])
        shares = zip(self._shares, results, strict=True)
        extras = {share.start + i: extra for share, (_, found) in shares for i, extra in found.items()}
        names = records.dtype.names or () if extras else ()
        unfit = [name for name in names if any(name in extra for extra in extras.values())]
        info = _columns(records, mask, unfit)
        for i in np.flatnonzero(mask).tolist() if unfit else sorted(extras):
            env_info = {name: from_record(records[i][name]) for name in unfit} | extras.get(i, {})
            self._add_info(info, {name: value for name, value in env_info.items() if value is not Absent}, i)
        return info


def _check(num_envs: Any, num_workers: Any, max_episode_steps: Any, variants: Sequence[Any], render_mode: Any) -> None:
    if not is_whole(num_envs) or not 1 <= num_envs <= MAX_ENVS:
        raise ValueError(f"num_envs must be whole and from 1 to {MAX_ENVS:,}, got {num_envs!r}")
    if max_episode_steps not in (None, -1) and not (is_whole(max_episode_steps) and max_episode_steps >= 1):
        raise ValueError(f"max_episode_steps must be whole and at least 1, -1 or None, got {max_episode_steps!r}")
    if num_workers is not None and not (is_whole(num_workers) and num_workers >= 0):
        raise ValueError(f"num_workers must be whole and not negative, or None, got {num_workers!r}")
    if render_mode == "human":
        raise ValueError("render_mode must be None or 'rgb_array' in a vector environment, got 'human'")
    if not 1 <= len(variants) <= num_envs:
        raise ValueError(f"variants must be 1 to num_envs ({num_envs}), got {len(variants)}")


def _make(make_env: Any, wrappers: Sequence[Any], max_episode_steps: int | None, arguments: dict[str, Any]) -> Any:
    env = make_env(**arguments)
    if max_episode_steps is not None and (wrappers or env is not env.unwrapped):
        env = gymnasium.wrappers.TimeLimit(env, int(max_episode_steps))
    for wrapper in wrappers:
        env = wrapper(env)
    return env


def make_vec(id: str, num_envs: int = 1, *, wrappers: Sequence[Callable[[Any], Any]] = (), **arguments: Any) -> Any:
    """Create a vector environment as `gymnasium.make_vec` does, with `wrappers` around each sub-environment."""
    if wrappers:
        arguments["env_wrappers"] = wrappers
    return gymnasium.make_vec(id, num_envs, **arguments)


def _split(makers: Sequence[Any], num_envs: int, num_workers: int) -> Iterator[tuple[Any, int, slice]]:
    """Split equal shares of the makers among processes; yield maker, process and slice of sub-environments in order."""
    bounds = [-(-i * num_envs // len(makers)) for i in range(len(makers) + 1)]
    turns = itertools.cycle(range(num_workers))
    for make_one, (first, last) in zip(makers, itertools.pairwise(bounds), strict=True):
        counts = np.bincount([next(turns) for _ in range(last - first)], minlength=num_workers).tolist()
        for process, count in enumerate(counts):
            if count:
                yield make_one, process, slice(first, first + count)
                first += count


def _columns(records: np.ndarray, mask: np.ndarray, without: Sequence[str] = ()) -> dict[str, Any]:
    info: dict[str, Any] = {}
    for name in records.dtype.names or ():
        if name not in without:
            column = records[name]
            info[name] = _columns(column, mask) if column.dtype.names else column.copy()
            info[f"_{name}"] = mask.copy()
    return info
