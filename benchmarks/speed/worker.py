"""Processes that measure, each confined to a number of cores.

How many threads Numba starts and on which cores a process runs is decided once for a process, so that each number of
cores has a process of its own. A process waits without using a core while another one measures.
"""

import contextlib
import gc
import multiprocessing
import os
import signal
import time
import traceback
import tracemalloc
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from benchmarks.speed.designs import Case, Design, Drive, open_drive
from benchmarks.speed.halls import Hall, make_hall
from benchmarks.speed.kernels import make_kernels, time_kernel

WARM_UP = 5000
"""Steps of all sub-environments together before anything is measured, but 20 to 100 of each."""
STATE_ENVS = (4, 12)
"""Numbers of sub-environments whose memory is compared."""


class Sample(NamedTuple):
    """One measurement."""

    steps_per_second: float
    """Steps of all sub-environments together, by the clock on the wall [1/s]."""
    share: float
    """Time that the process computed, over that on the wall and its cores."""


class Bench:
    """What runs in a process that measures."""

    def __init__(self) -> None:
        self._halls: dict[int, Hall] = {}
        self._drives: dict[Case, Drive] = {}

    def open(self, cases: list[Case]) -> None:
        """Set cases going, in place of those before."""
        self.close()
        for case in cases:
            self._drives[case] = open_drive(case, self._hall(case.num_bodies))
            self._drives[case].step(min(max(WARM_UP // case.design.num_envs, 20), 100))
        # What is alive now stays so, and would only delay whichever design next sets off the garbage collector.
        gc.collect()
        gc.freeze()

    def measure(self, case: Case, seconds: float) -> Sample:
        """Drive on for about so many seconds."""
        drive, design = self._drives[case], case.design
        count, elapsed = 0, 0.0
        computing, start = time.process_time(), time.perf_counter()
        while elapsed < seconds:
            drive.step(drive.at_once)
            count += drive.at_once
            elapsed = time.perf_counter() - start
        share = (time.process_time() - computing) / (elapsed * design.cores)
        return Sample(count * design.num_envs / elapsed, share)

    def close(self) -> None:
        """Stop all cases."""
        for drive in self._drives.values():
            drive.close()
        self._drives.clear()
        gc.unfreeze()
        gc.collect()

    def measure_kernels(self, num_bodies: int, seconds: float, repeats: int) -> list[tuple[str, float, float]]:
        """Return name, time, and time of the reference of every kernel [us]."""
        kernels = make_kernels(self._hall(num_bodies))
        return [(kernel.name, *time_kernel(kernel, seconds, repeats)) for kernel in kernels]

    def measure_state(self, num_bodies: int, slam: str) -> int:
        """Return how much memory a further sub-environment takes, observations included [bytes]."""
        hall = self._hall(num_bodies)
        open_drive(Case(Design("vector"), num_bodies, slam), hall).close()  # fills what all share
        sizes = []
        for num_envs in STATE_ENVS:
            gc.collect()
            tracemalloc.start()
            drive = open_drive(Case(Design("vector", num_envs), num_bodies, slam), hall)
            drive.step(1)
            gc.collect()
            sizes.append(tracemalloc.get_traced_memory()[0])
            drive.close()
            tracemalloc.stop()
        return round((sizes[1] - sizes[0]) / (STATE_ENVS[1] - STATE_ENVS[0]))

    def _hall(self, num_bodies: int) -> Hall:
        if num_bodies not in self._halls:
            self._halls[num_bodies] = make_hall(num_bodies)
        return self._halls[num_bodies]


class Worker:
    """A `Bench` in a process of its own."""

    def __init__(self, cores: list[int]) -> None:
        """Start the process.

        Args:
            cores: those that it and its threads and processes may use.
        """
        context = multiprocessing.get_context("spawn")
        self._pipe, far_end = context.Pipe()
        self._process = context.Process(target=_serve, args=(far_end, cores))
        with _environment(NUMBA_NUM_THREADS=str(len(cores)), OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1"):
            self._process.start()
        far_end.close()

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method of the bench and wait for what it returns.

        Raises:
            RuntimeError: it failed there; the message says where.
        """
        self._pipe.send((method, arguments))
        try:
            result, failure = self._pipe.recv()
        except EOFError:
            self._process.join()
            raise RuntimeError(f"a measuring process died with exit code {self._process.exitcode}") from None
        if failure is not None:
            raise RuntimeError(f"a measuring process failed:\n{failure}")
        return result

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.join(timeout=10.0)
        if self._process.is_alive():
            self._process.terminate()


def _serve(pipe: Connection, cores: list[int]) -> None:
    """Answer calls until the other end of the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the run closes its workers.
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)
    bench = Bench()
    while True:
        try:
            method, arguments = pipe.recv()
        except (EOFError, ConnectionResetError):
            break
        try:
            result, failure = getattr(bench, method)(*arguments), None
        except Exception:
            result, failure = None, traceback.format_exc()
        pipe.send((result, failure))
    bench.close()


@contextlib.contextmanager
def _environment(**variables: str) -> Iterator[None]:
    """Set environment variables for a while."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value
