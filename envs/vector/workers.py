"""Worker processes, each with a shard."""

import contextlib
import os
import pickle
import select
import signal
import time
import traceback
import weakref
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from .shard import Extras, Shard

SPIN_TIME = 0.002
"""How long a process waits for the others before it sleeps [s]."""


class Worker:
    """A process with a shard."""

    def __init__(self, context: Any, make_shard: Callable[[], Shard]) -> None:
        self._pipe, far_end = context.Pipe()
        self._process = context.Process(target=serve, args=(far_end, make_shard), daemon=True)
        self._process.start()
        far_end.close()
        self.close = weakref.finalize(self, _stop, self._pipe, self._process)

    def send(self, request: bytes) -> None:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # `receive` tells that the worker has died
            self._pipe.send_bytes(request)

    def receive(self, dtype: np.dtype | None) -> Any:
        """Return the result of the last request, or its error."""
        try:
            wait(self._pipe)
            answer = self._pipe.recv_bytes()
        except (EOFError, ConnectionResetError):
            self._process.join()
            return RuntimeError(f"a worker process died with exit code {self._process.exitcode}")
        if answer[:1] == b".":
            return np.frombuffer(answer, dtype, offset=1), Extras()
        return pickle.loads(answer[1:])


def _stop(pipe: Any, process: Any) -> None:
    # Not only closed: workers that were forked later hold copies of this end.
    with contextlib.suppress(OSError):
        pipe.send_bytes(b"q")
    pipe.close()
    process.join(timeout=10.0)
    if process.is_alive():
        process.terminate()


def wait(pipe: Connection) -> None:
    """Wait for a message for a while without sleeping: to be woken takes as long as a robot takes for its step."""
    if not hasattr(select, "poll"):  # Windows
        return
    poll = select.poll()
    poll.register(pipe.fileno(), select.POLLIN)
    end = time.perf_counter() + SPIN_TIME
    while not poll.poll(0) and time.perf_counter() < end:
        os.sched_yield()  # the other process may share this core


def serve(pipe: Connection, make_shard: Callable[[], Shard]) -> None:
    """Answer a vector environment's calls until it sends b"q" or closes the pipe; what a worker process runs.

    Each answer is one byte, "." for a step without extras, "+" for a pickled result, "!" for an error, and its bytes.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent closes its workers.
    shard: Shard | None = None
    while True:
        try:
            wait(pipe)
            request = pipe.recv_bytes()
        except (EOFError, ConnectionResetError):
            break
        if request == b"q":
            break
        try:
            shard = shard or make_shard()
            if request == b"s":
                records, extras = shard.step()
                answer = b"+" + pickle.dumps((records, extras)) if extras else b"." + records.tobytes()
            else:
                method, args = pickle.loads(request)
                answer = b"+" + pickle.dumps(getattr(shard, method)(*args) if method else None)
        except Exception as error:
            error.add_note(f"in a worker process:\n{traceback.format_exc()}")
            answer = b"!" + _dump_error(error)
        pipe.send_bytes(answer)
    if shard is not None:
        shard.close()


def _dump_error(error: Exception) -> bytes:
    try:
        return pickle.dumps(error)
    except Exception:
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
