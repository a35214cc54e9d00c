"""Parallel execution in processes."""

import contextlib
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor

from lidarnaut.envs.processes import start_worker


@contextlib.contextmanager
def make_pool(num_workers: int | None) -> Iterator[Executor]:
    """Yield an executor that runs calls in `num_workers` processes, by default one per core.

    Exceptions cancel running calls.
    """
    # Forked copies of processes with threads (torch, numba) may deadlock.
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(num_workers, spawn, start_worker) as pool:
        try:
            yield pool
        except BaseException:
            for process in list((pool._processes or {}).values()):
                process.terminate()
            raise
