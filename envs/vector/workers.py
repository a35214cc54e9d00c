"""Worker processes, each with a shard."""

import contextlib
import multiprocessing
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

from lidarnaut.envs.processes import follow_parent

from .memory import Extras
from .shard import Shard

SPIN_TIME = 0.002
"""How long a process waits for the others before it sleeps [s]."""
UNGUARDED = "; on Windows, macOS and Python 3.14 workers import the script, which needs `if __name__ == '__main__':`"
_processes = weakref.WeakSet[Any]()
if hasattr(os, "register_at_fork"):  # a forked process would end its parent's workers when it exits
    os.register_at_fork(after_in_child=lambda: multiprocessing.process._children.difference_update(_processes))  # type: ignore[attr-defined]


class Worker:
    """A process with a shard."""

    def __init__(self, context: Any, make_shard: Callable[[], Shard]) -> None:
        self._pipe, far_end = context.Pipe()
        self.process = context.Process(target=serve, args=(far_end, make_shard), daemon=True)
        try:
            self.process.start()
        except ConnectionError as error:  # of a fork server, which has imported the script
            raise RuntimeError(f"no worker process could be started{UNGUARDED}") from error
        _processes.add(self.process)
        far_end.close()
        self.close = weakref.finalize(self, _stop, self._pipe, self.process, os.getpid())

    def send(self, request: bytes) -> None:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # `receive` tells that the worker has died
            self._pipe.send_bytes(request)

    def receive(self, dtype: np.dtype | None) -> Any:
        """Return the result of the last request, or its error."""
        try:
            answer = receive(self._pipe)
        except (EOFError, ConnectionResetError):
            self.process.join()
            hint = UNGUARDED if self.process.exitcode == 1 and self.process._start_method != "fork" else ""
            return RuntimeError(f"a worker process died with exit code {self.process.exitcode}{hint}")
        if answer[:1] == b".":
            return np.frombuffer(answer, dtype, offset=1), Extras()
        try:
            content = pickle.loads(answer[1:])
        except Exception as error:
            return error
        if answer[:1] == b"!":
            content, lines = content
            content.add_note(f"in a worker process:\n{lines}")
        return content


def _stop(pipe: Any, process: Any, owner: int) -> None:
    if os.getpid() != owner:  # a process forked from the owner, which ends or collects its copy
        return
    # Not only closed: workers that were forked later hold copies of this end.
    with contextlib.suppress(OSError):
        pipe.send_bytes(b"q")
    pipe.close()
    process.join(timeout=10.0)
    if process.is_alive():
        process.kill()


def receive(pipe: Connection) -> bytes:
    """Return the next message, awake for a while: to be woken takes as long as a robot takes for its step."""
    if hasattr(select, "poll"):  # not on Windows
        poll = select.poll()
        poll.register(pipe.fileno(), select.POLLIN)
        end = time.perf_counter() + SPIN_TIME
        while not poll.poll(0) and time.perf_counter() < end:
            os.sched_yield()  # the other process may share this core
    return pipe.recv_bytes()


def serve(pipe: Connection, make_shard: Callable[[], Shard]) -> None:
    """Answer a vector environment's calls until it sends b"q" or is gone; what a worker process runs.

    Each answer is one byte, "." for a step without extras, "+" for a pickled result, "!" for an error, and its bytes.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent closes its workers.
    multiprocessing.current_process().daemon = False  # users' code may have processes of its own
    follow_parent()
    shard: Shard | None = None
    with contextlib.suppress(EOFError, ConnectionError):
        while (request := receive(pipe)) != b"q":
            try:
                shard = shard or make_shard()
                if request == b"s":
                    records, extras = shard.step()
                    answer = b"+" + pickle.dumps((records, extras)) if extras else b"." + records.tobytes()
                else:
                    method, args = pickle.loads(request)
                    answer = b"+" + pickle.dumps(getattr(shard, method)(*args) if method else None)
            except Exception as error:
                answer = b"!" + pickle.dumps((_portable(error), traceback.format_exc()))
            pipe.send_bytes(answer)
    if shard is not None:
        shard.close()


def _portable(error: Exception) -> Exception:
    """Return an error that pickles and unpickles: the same, or one that says the same."""
    with contextlib.suppress(Exception):
        if isinstance(pickle.loads(pickle.dumps(error)), Exception):
            return error
    return RuntimeError(f"{type(error).__name__}: {error}")
