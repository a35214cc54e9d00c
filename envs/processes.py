"""Helpers for worker processes."""

import _signal  # type: ignore[import-not-found]
import contextlib
import multiprocessing
import multiprocessing.connection
import multiprocessing.resource_tracker
import os
import signal
import threading
from collections.abc import Iterator


def num_cores() -> int:
    """Return the number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def start_worker() -> None:
    """Initialize a worker process; `initializer` of a `concurrent.futures.ProcessPoolExecutor`.

    The worker ends with its parent and silently on Ctrl-C. It computes with one thread.
    """
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # ignored in background scripts, whose workers continue
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # blocked by `interrupts_held`
    os.environ["OMP_NUM_THREADS"] = "1"  # before torch is imported
    follow_parent()


def follow_parent() -> None:
    """End this process as soon as its parent process has ended."""
    parent, parent_id = multiprocessing.parent_process(), os.getppid()
    assert parent is not None

    def follow() -> None:
        while not multiprocessing.connection.wait([parent.sentinel], timeout=1.0) and os.getppid() == parent_id:
            pass
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def is_interrupt(error: BaseException | None) -> bool:
    """Return whether an error comes from Ctrl-C. In compiled code, Ctrl-C becomes the cause of a `SystemError`."""
    return error is not None and (isinstance(error, KeyboardInterrupt) or is_interrupt(error.__cause__))


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Context manager that blocks Ctrl-C while processes start, and in these processes until `start_worker`."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Otherwise the first process starts the tracker, which unblocks interrupts.
    multiprocessing.resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def interrupts_delayed() -> Iterator[None]:
    """Context manager that delays the first Ctrl-C to the end of its block: interrupts may crash Numba.

    Where Ctrl-C is ignored, as in background jobs of a script, it delays SIGTERM, which ends these.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # `signal.getsignal` takes 10 us to convert each handler to an enumeration.
    awaited, before = signal.SIGINT, _signal.getsignal(signal.SIGINT)
    if before == signal.SIG_IGN:
        awaited, before = signal.SIGTERM, _signal.getsignal(signal.SIGTERM)
    if before is None:
        yield
        return
    came = []

    def note(number: int, _: object) -> None:
        came.append(number)
        _signal.signal(awaited, before)

    _signal.signal(awaited, note)
    try:
        yield
    finally:
        _signal.signal(awaited, before)
        if came:
            signal.raise_signal(awaited)
