"""Independent runs, side by side in processes."""

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

from envs.progress import Progress


def run_each(
    work: Callable[..., Any],
    tasks: Sequence[tuple[Any, ...]],
    jobs: int,
    on_result: Callable[[Any], None] = lambda _: None,
    **bar: Any,
) -> list[Any]:
    """Call a function with each tuple of arguments, behind a progress bar; return the results in the order of tasks.

    Args:
        work: the function; not one of a `__main__.py`, which other processes do not import.
        tasks: arguments of each call.
        jobs: processes; 1 stays in this one.
        on_result: called with each result as it comes.
        bar: what the progress bar shows: `desc`, `unit`.
    """
    if jobs == 1:
        results = []
        for task in Progress(tasks, **bar):
            results.append(work(*task))
            on_result(results[-1])
        return results
    # A fresh interpreter each: forked copies of a process that has threads may hang.
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        try:
            futures = [pool.submit(work, *task) for task in tasks]
            for future in Progress(as_completed(futures), total=len(tasks), **bar):
                on_result(future.result())
            return [future.result() for future in futures]
        finally:
            pool.shutdown(cancel_futures=True)
