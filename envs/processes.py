"""Worker processes."""

import multiprocessing
import multiprocessing.connection
import os
import signal
import threading


def start_worker() -> None:
    """Begin a worker: the `initializer` of a `concurrent.futures.ProcessPoolExecutor`.

    It ends when its parent has died, however that was; it would wait for tasks for ever. Ctrl-C, which reaches every
    process of the terminal, ends it without a word: the parent tells. It computes with one thread, since workers are
    as many as the cores.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.environ["OMP_NUM_THREADS"] = "1"  # before torch is imported
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_follow, args=(parent.sentinel,), daemon=True).start()


def _follow(parent: int) -> None:
    """End this process when its parent has died."""
    multiprocessing.connection.wait([parent])
    os._exit(1)
