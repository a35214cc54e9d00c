"""Damaged inputs by the thousand: how many are refused with a clear error, accepted, or bring something down."""

import logging
import multiprocessing
import os
import shutil
import tempfile
import time
import warnings
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from envs.progress import Progress

TIME_LIMIT = 10.0
"""Processor time that an input may take [s]."""
START_LIMIT = 120.0
"""Processor time that the first input of a process may take, which compiles and imports [s]."""
PATIENCE = 10.0
"""Time on the clock over processor time after which a process hangs all the same: others may use the machine."""
MEMORY_LIMIT = 16 * 2**30
"""Address space of the process that uses the inputs [bytes]."""
LONGEST = 5000
"""Longest message that is clear [characters]."""


@dataclass
class Counts:
    """What became of the inputs of a kind."""

    kind: str
    refused: int = 0
    """By an error that names the file."""
    accepted: int = 0
    failures: list[str] = field(default_factory=list)
    """Each other outcome, with the number of the input."""


def try_inputs(kinds: tuple[str, ...], count: int, seed: int, *, progress: bool = True) -> list[Counts]:
    """Try `count` damaged inputs of each kind, in a process of their own.

    Input `i` of a kind depends on the seed, the kind and `i` alone.
    """
    results = []
    with tempfile.TemporaryDirectory() as folder, _Process(Path(folder)) as process:
        for kind in kinds:
            counts = Counts(kind)
            for number in Progress(range(count), desc=kind, unit="input", disable=not progress):
                outcome, said = process.use(kind, number, seed)
                if outcome == "refused":
                    counts.refused += 1
                elif outcome == "accepted":
                    counts.accepted += 1
                else:
                    counts.failures.append(f"input {number}: {said}")
            results.append(counts)
    return results


class _Process:
    """A process that uses inputs; one that hangs or dies is replaced."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._context = folder, multiprocessing.get_context("spawn")
        self._process: Any = None

    def __enter__(self) -> "_Process":
        return self

    def __exit__(self, *error: object) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()

    def use(self, kind: str, number: int, seed: int) -> tuple[str, str]:
        """Return the outcome of an input, and what was said."""
        limit = TIME_LIMIT
        if self._process is None:
            limit = START_LIMIT
            self._pipe, far_end = self._context.Pipe()
            self._process = self._context.Process(target=serve, args=(far_end, self._folder), daemon=True)
            self._process.start()
            far_end.close()
        try:
            self._pipe.send((kind, number, seed))
            begin, used = time.monotonic(), processor_time(self._process.pid)
            while time.monotonic() - begin < PATIENCE * limit and processor_time(self._process.pid) - used < limit:
                if self._pipe.poll(0.1):
                    return self._pipe.recv()
            outcome = "failed", f"took longer than {limit:g} s"
        except (EOFError, ConnectionResetError, BrokenPipeError):
            self._process.join()
            outcome = "failed", f"the process died with exit code {self._process.exitcode}"
        self.__exit__()
        self._process = None
        return outcome


def processor_time(pid: int) -> float:
    """Return the processor time that a process has used [s]; 0 where the operating system does not tell."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def serve(pipe: Connection, folder: Path) -> None:
    """Use the inputs that are asked for, each in a folder that is removed afterwards."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    except (ImportError, ValueError):
        pass
    logging.disable()
    warnings.simplefilter("ignore")
    while True:
        try:
            kind, number, seed = pipe.recv()
        except EOFError:
            return
        own = folder / "inputs"
        shutil.rmtree(own, ignore_errors=True)  # of a process that was ended
        own.mkdir()
        pipe.send(outcome_of(kind, number, seed, own))
        shutil.rmtree(own)


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
