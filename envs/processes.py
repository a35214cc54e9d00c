"""Worker processes."""

import _signal  # type: ignore[import-not-found]
import contextlib
import multiprocessing
import multiprocessing.connection
import multiprocessing.resource_tracker
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor


def start_worker() -> None:
    """Begin a worker: the `initializer` of a `concurrent.futures.ProcessPoolExecutor`.

    It follows its parent. Ctrl-C, which reaches every process of the terminal, ends it without a word: the parent
    tells. It computes with one thread, since workers are as many as the cores.
    """
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # as in the background of a script: the parent goes on, too
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # held back by `interrupts_held`
    os.environ["OMP_NUM_THREADS"] = "1"  # before torch is imported
    follow_parent()


def follow_parent() -> None:
    """Let this process end when its parent has died, however that was; it would wait for tasks for ever."""
    parent, parent_id = multiprocessing.parent_process(), os.getppid()
    assert parent is not None

    def follow() -> None:  # processes that were forked later may hold the sentinel open
        while not multiprocessing.connection.wait([parent.sentinel], timeout=1.0) and os.getppid() == parent_id:
            pass
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back while processes are started, for this process until then, for them until `start_worker`.

    They would print a traceback if it came while they import their modules.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    # It starts with the first process, and lets interrupts through again.
    multiprocessing.resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def interrupts_delayed() -> Iterator[None]:
    """Let Ctrl-C wait for the end of a short block, unless it comes again: where Numba meets it, it may crash."""
    # The functions of `signal` convert each handler to an enumeration, which takes 10 us.
    before = _signal.getsignal(signal.SIGINT)
    if before is None or threading.current_thread() is not threading.main_thread():  # it does not come as an exception
        yield
        return
    came = []

    def note(number: int, _: object) -> None:
        came.append(number)
        _signal.signal(signal.SIGINT, before)

    _signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        _signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)


def stop_workers(pool: ProcessPoolExecutor) -> None:
    """End the processes of a pool at once."""
    for process in list((pool._processes or {}).values()):
        process.terminate()
