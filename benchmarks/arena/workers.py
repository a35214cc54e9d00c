"""Run episodes sequentially or in worker processes."""

import contextlib
import logging
import traceback
from collections.abc import Iterator, Mapping
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium

from lidarnaut.agents.policy_names import PolicySource, short
from lidarnaut.agents.pools import make_pool
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.baselines.episode import prepare, run_episode
from lidarnaut.baselines.policy import Policy
from lidarnaut.benchmarks.arena.evaluation_folder import Key, Row, columns_of
from lidarnaut.benchmarks.arena.measures import Measures
from lidarnaut.benchmarks.arena.settings import Case
from lidarnaut.benchmarks.arena.trace import Recorder
from lidarnaut.envs.command_line import show_log
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.player import EpisodeRecorder
from lidarnaut.envs.processes import interrupts_held, is_interrupt
from lidarnaut.envs.wrappers import BagRecorder

WARM_UP_STEPS = 20
"""Number of steps before a policy's first episode in a process, so that compilation is not timed."""
NOT_RUN = "not tried yet"
FAULTS = (Exception, SystemExit)
"""Exceptions that count as a failed episode; the evaluation continues."""


@dataclass(frozen=True, slots=True)
class Job:
    """Episode to run in a process: policy, conditions and outputs."""

    key: Key
    policy: PolicySource
    case: Case
    custom: Mapping[str, Any] = field(default_factory=dict)
    """User-defined world, robot and SLAM objects, by name."""
    bag: Path | None = None
    """Output file for a ROS 2 bag; None for no bag."""
    has_recording: bool = False
    """Whether to record the episode for replay in a browser."""
    is_logged: bool = False
    """Whether the process of the episode prints messages of level INFO."""

    @property
    def conditions(self) -> tuple[Any, ...]:
        """Environment settings; episodes with equal settings share an environment object."""
        return self.case, repr(self.policy.arguments)

    def make_env(self) -> gymnasium.Env[Any, Any]:
        return self.case.make_env(self.custom, self.policy.arguments)


@dataclass(frozen=True, slots=True)
class Result:
    """Result of an episode: measured values, or the reason of a failure."""

    key: Key
    row: Row | None = None
    """Measured values by column name of `episodes.csv`; None after a failure."""
    trace: bytes = b""
    """Content of the NPZ file with progress, path and map (`Trace`); empty after a failure."""
    recording: bytes = b""
    """Content of the replay file; empty without a recording."""
    reason: str = ""


def explain_fault(error: BaseException) -> str:
    """Return an error and its place as text; raise KeyboardInterrupt if it comes from Ctrl-C in compiled code."""
    if is_interrupt(error):
        raise KeyboardInterrupt from error
    *_, last = traceback.extract_tb(error.__traceback__)
    return f"{type(error).__name__}: {' '.join(str(error).split())} ({Path(last.filename).name}, line {last.lineno})"


def run_all(tasks: list[Job], jobs: int) -> Iterator[Result]:
    """Run episodes in processes, and yield results in order of completion; RuntimeError if a process dies."""
    if jobs == 1 or len(tasks) < 2:
        with contextlib.closing(_Worker()) as worker:
            yield from map(worker.run, tasks)
        return
    with make_pool(min(jobs, len(tasks))) as pool:
        try:
            with interrupts_held():
                pending = {pool.submit(run_in_worker, task) for task in tasks}
            for future in as_completed(pending):
                pending.discard(future)  # frees the trace
                yield future.result()
        except BrokenProcessPool as error:
            raise RuntimeError(
                "a process died while it ran an episode (out of memory?); run the same command to continue"
            ) from error


class _Worker:
    def __init__(self) -> None:
        self._env: gymnasium.Env[Any, Any] | None = None
        self._conditions: tuple[Any, ...] | None = None
        self._policies: dict[str, Policy] = {}

    def run(self, task: Job) -> Result:
        try:
            return self._run(task)
        except FAULTS as error:
            reason = explain_fault(error)
            if not isinstance(error, (ValueError, CheckpointError, SystemExit)):  # without traceback
                logging.getLogger(__name__).exception("%s", task.key)
            return Result(task.key, reason=reason)

    def _run(self, task: Job) -> Result:
        if task.is_logged:
            show_log()
        if self._env is None or task.conditions != self._conditions:
            self.close()
            self._env, self._conditions = task.make_env(), task.conditions
        env, policy = self._env, self._policies.get(task.policy.name)
        if policy is None:
            policy = task.policy.make(env.action_space)
            prepare(env, policy, task.key.seed, WARM_UP_STEPS)
            self._policies[task.policy.name] = policy
        inner = lidar_env_of(env)
        recorder, measures = Recorder(inner), Measures(inner.task.measures, inner.task.progress)
        film = EpisodeRecorder(env, policy) if task.has_recording else None
        with BagRecorder(env, task.bag) if task.bag else contextlib.nullcontext(), film or contextlib.nullcontext():
            episode = run_episode(env, policy, task.key.seed, recorder.watch)
        known = task.key._asdict() | {"model": task.policy.model}
        columns = columns_of(measures).items()
        row = {name: read(known[name] if name in known else getattr(episode, name)) for name, read in columns}
        recording = film.recording(describe(row, measures)).to_bytes() if film else b""
        return Result(task.key, row, recorder.trace(episode).to_bytes(), recording)

    def close(self) -> None:
        if self._env is not None:
            self._env.close()
            self._env = None


_worker = _Worker()


def run_in_worker(task: Job) -> Result:
    return _worker.run(task)


def describe(row: Row, measures: Measures) -> dict[str, Any]:
    figures = {}
    for measure in measures.all:
        if measure.name not in ("decision_ms", "success"):  # not reproducible; covered by `end_reason`
            title = f"{measure.label} [{measure.unit}]" if measure.unit else measure.label
            figures[title] = measure.text(row[measure.name]).removesuffix(".0" if measure.name == "collisions" else "-")
    about = {"explorer": short(row["policy"])} | {name: row[name] for name in ("world", "robot", "seed")}
    about["progress"] = measures.label
    ended = {"duration [s]": f"{row['duration']:.0f}", "ended by": row["end_reason"].replace("_", " ")}
    return about | {"end_reason": row["end_reason"], "figures": figures | ended}
