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
import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from typing import Any, NamedTuple

from benchmarks.speed.designs import Case, Design, Drive, open_drive
from benchmarks.speed.halls import make_hall
from benchmarks.speed.kernels import make_kernels, time_kernel

WARM_UP = 5000
"""Steps of all sub-environments together before anything is measured, but 20 to 100 of each."""
STATE_ENVS = (4, 12)
"""Numbers of sub-environments whose memory is compared."""

_hall = lru_cache(maxsize=2)(make_hall)


class Sample(NamedTuple):
    """One measurement."""

    steps_per_second: float
    """Steps of all sub-environments together, by the clock on the wall [1/s]."""
    share: float
    """Time that the process computed, over that on the wall and its cores."""


class Bench:
    """What runs in a process that measures."""

    def __init__(self) -> None:
        self._drives: dict[Case, Drive] = {}

    def open(self, cases: list[Case]) -> None:
        """Set cases going, in place of those before."""
        self.close()
        for case in cases:
            self._drives[case] = open_drive(case, _hall(case.num_bodies))
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

    def measure_kernels(self, num_bodies: int, seconds: float, repeats: int) -> list[dict[str, Any]]:
        """Return name, time, and time of the reference of every kernel [us]."""
        rows = []
        for kernel in make_kernels(_hall(num_bodies)):
            us, us_reference = time_kernel(kernel, seconds, repeats)
            rows.append({"kernel": f"{kernel.name} (hall_{num_bodies})", "us": us, "us_reference": us_reference})
        return rows

    def measure_state(self, num_bodies: int, slam: str) -> int:
        """Return how much memory a further sub-environment takes, observations included [bytes]."""
        hall = _hall(num_bodies)
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


class Worker:
    """A `Bench` in a process of its own."""

    def __init__(self, cores: list[int]) -> None:
        """Start the process; it and its threads and processes may use some cores."""
        self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _start, (cores,))
        before = dict(os.environ)
        os.environ |= {"NUMBA_NUM_THREADS": str(len(cores)), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        try:
            self.call("close")  # the process starts with the first call
        finally:
            os.environ.clear()
            os.environ.update(before)

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method of the bench and wait for what it returns; what it raises is raised here.

        Raises:
            RuntimeError: the process died.
        """
        try:
            return self._pool.submit(_call, method, *arguments).result()
        except BrokenProcessPool as error:
            raise RuntimeError(f"a measuring process died in {method!r} (out of memory?)") from error

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(RuntimeError):
            self.call("close")
        self._pool.shutdown()


_bench = Bench()


def _start(cores: list[int]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the run closes its workers.
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)


def _call(method: str, *arguments: Any) -> Any:
    return getattr(_bench, method)(*arguments)
