"""Damaged inputs by the thousand: how many are refused with a clear error, accepted, or bring something down."""

import logging
import multiprocessing
import resource
import shutil
import signal
import tempfile
import warnings
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from envs.progress import Progress

from . import Report

TIME_LIMIT, START_LIMIT = 10, 120
"""Processor time that an input may take, and the first one of a process, which compiles and imports [s]."""
PATIENCE = 10
"""Time on the clock over processor time after which a process hangs all the same: others may use the machine."""
MEMORY_LIMIT = 16 * 2**30
"""Address space of the process that uses the inputs [bytes]."""
LONGEST = 5000
"""Longest message that is clear [characters]."""


def try_inputs(kinds: tuple[str, ...], count: int, seed: int, *, progress: bool = True) -> Report:
    """Try `count` damaged inputs of each kind, in a process of their own; one that hangs or dies is replaced.

    Input `i` of a kind depends on the seed, the kind and `i` alone.
    """
    rows, failures = [], []
    with tempfile.TemporaryDirectory() as folder:
        process = _Process(Path(folder))
        for kind in kinds:
            row = {"damaged": kind, "tried": count, "refused with a clear error": 0, "accepted": 0, "failed": 0}
            for number in Progress(range(count), desc=kind, unit="input", disable=not progress):
                outcome, said = process.use(kind, number, seed)
                row["refused with a clear error" if outcome == "refused" else outcome] += 1
                if outcome == "failed":
                    failures.append(f"{kind}, input {number}: {said}")
            rows.append(row)
        process.end()
    return rows, failures


class _Process:
    """A process that uses inputs."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._process = folder, None

    def use(self, *what: Any) -> tuple[str, str]:
        """Return the outcome of an input, and what was said."""
        limit = TIME_LIMIT
        if self._process is None:
            limit, context = START_LIMIT, multiprocessing.get_context("spawn")
            self._pipe, far_end = context.Pipe()
            self._process = context.Process(target=serve, args=(far_end, self._folder), daemon=True)
            self._process.start()
            far_end.close()
        said = f"took longer than {limit:g} s"
        try:
            self._pipe.send((*what, limit))
            if self._pipe.poll(PATIENCE * limit):
                return self._pipe.recv()
        except (EOFError, ConnectionResetError, BrokenPipeError):
            self._process.join()
            if self._process.exitcode != -signal.SIGXCPU:
                said = f"the process died with exit code {self._process.exitcode}"
        self.end()
        return "failed", said

    def end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
        self._process = None


def serve(pipe: Connection, folder: Path) -> None:
    """Use the inputs that are asked for, each in a folder that is removed afterwards."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    logging.disable()
    warnings.simplefilter("ignore")
    while True:
        try:
            kind, number, seed, limit = pipe.recv()
        except EOFError:
            return
        limit_time(limit)
        own = folder / "inputs"
        shutil.rmtree(own, ignore_errors=True)  # of a process that was ended
        own.mkdir()
        pipe.send(outcome_of(kind, number, seed, own))
        shutil.rmtree(own)


def limit_time(limit: int) -> None:
    """Let the operating system end this process after about so much more processor time [s]."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    most = int(used.ru_utime + used.ru_stime) + 1 + limit
    resource.setrlimit(resource.RLIMIT_CPU, (most, resource.RLIM_INFINITY))


def outcome_of(kind: str, number: int, seed: int, folder: Path) -> tuple[str, str]:
    """Use an input: "accepted", "refused" by an error that names it, or "failed", and what was said."""
    from agents.run_folder import CheckpointError

    from .kinds import KINDS

    name = f"input{number}"
    try:
        KINDS[kind](folder, name, np.random.default_rng([seed, list(KINDS).index(kind), number]))
    except (ValueError, OSError, CheckpointError) as error:
        said = str(error)
        if name not in said:
            return "failed", f"no name in {type(error).__name__}: {said[:200]}"
        if len(said) > LONGEST:
            return "failed", f"a message of {len(said)} characters: {said[:200]}"
        return "refused", said
    except BaseException as error:
        return "failed", f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return "accepted", ""
