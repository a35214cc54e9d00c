"""Episodes, one after the other or side by side in processes."""

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np

from baselines.episode import run_episode
from baselines.explorer import Explorer
from benchmarks.arena.policies import Policy
from benchmarks.arena.records import Row, make_row
from benchmarks.arena.settings import Settings
from benchmarks.arena.trace import Recorder
from envs.explore import ExploreEnv

WARM_UP_STEPS = 20
"""Steps that a policy drives in a process before it is timed: compiling and loading on first use is no decision."""


@dataclass(frozen=True, slots=True)
class Task:
    """One episode to run."""

    settings: Settings
    """How."""
    policy: Policy
    """Who."""
    world: str
    """Where."""
    seed: int
    """Seed of the episode."""
    trace: Path
    """File to leave the episode's trace in."""


def run_all(tasks: list[Task], jobs: int) -> Iterator[Row]:
    """Yield the rows of tasks as they end."""
    if jobs == 1 or len(tasks) < 2:
        with contextlib.closing(_Workplace()) as workplace:
            for task in tasks:
                yield _run(workplace, task)
        return
    # A fresh interpreter each: forked copies of a process that has threads (torch, numba) may hang.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(tasks)), context, _start_worker) as pool:
        futures = {pool.submit(_run_in_worker, task): task for task in tasks}
        try:
            for future in as_completed(futures):
                yield future.result()
        except BrokenProcessPool as error:
            raise RuntimeError(
                "a process died while it ran an episode (out of memory?); the same command goes on from there"
            ) from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


class _Workplace:
    """Keeps one environment and the explorers between the episodes of a process."""

    def __init__(self) -> None:
        self._env: gymnasium.Env[Any, Any] | None = None
        self._env_key: tuple[Settings, str] | None = None
        self._explorers: dict[Policy, Explorer] = {}
        self._warm: set[tuple[Policy, str]] = set()

    def run(self, task: Task) -> Row:
        """Run an episode, leave its trace, and return its row."""
        env = self._find_env(task)
        explorer = self._explorers.get(task.policy) or task.policy.make()
        self._explorers[task.policy] = explorer
        if (task.policy, task.world) not in self._warm:
            prepare(env, explorer, task.seed, WARM_UP_STEPS)
            self._warm.add((task.policy, task.world))
        place = cast(ExploreEnv, env.unwrapped)
        recorder = Recorder(place)
        episode = run_episode(env, explorer, task.seed, recorder.watch)
        recorder.trace(episode.curve).save(task.trace)
        return make_row(task.policy, task.world, task.seed, place.robot.name, episode)

    def close(self) -> None:
        """Close the environment."""
        if self._env is not None:
            self._env.close()
            self._env = None

    def _find_env(self, task: Task) -> gymnasium.Env[Any, Any]:
        key = (task.settings, task.world)
        if self._env is None or key != self._env_key:
            self.close()
            self._env, self._env_key = task.settings.make_env(task.world), key
        return self._env


def prepare(env: gymnasium.Env[Any, Any], explorer: Explorer, seed: int, steps: int = 0) -> None:
    """Let an explorer get ready for a place, and drive it for a few steps that are not measured."""
    place = cast(ExploreEnv, env.unwrapped)
    observation, _ = env.reset(seed=seed)
    explorer.reset(place.robot, place.control_period, np.random.default_rng(seed))
    for _ in range(steps):
        action = explorer.act(observation, place.belief)
        if explorer.end_reason is not None:
            break
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            break


_workplace = _Workplace()
"""The workplace of a worker process."""


def _start_worker() -> None:
    # Ctrl-C reaches every process of the terminal: workers go at once and without a word, the parent tells.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Workers are as many as the cores, so each computes with one thread. Set before torch is imported.
    os.environ["OMP_NUM_THREADS"] = "1"
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_follow, args=(parent.sentinel,), daemon=True).start()


def _follow(parent: int) -> None:
    """End this process when its parent has died: a worker would wait for tasks for ever."""
    multiprocessing.connection.wait([parent])
    os._exit(1)


def _run_in_worker(task: Task) -> Row:
    return _run(_workplace, task)


def _run(workplace: _Workplace, task: Task) -> Row:
    """Run an episode; an error says in which one it came up, and what to do."""
    try:
        return workplace.run(task)
    except Exception as error:
        error.add_note(
            f"This came up while {task.policy.name} explored {task.world} with seed {task.seed}. "
            "The episodes before it are kept; the same command goes on from there."
        )
        raise
