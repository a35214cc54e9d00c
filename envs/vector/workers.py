"""Worker processes of vector environments."""

import contextlib
import multiprocessing
import os
import pickle
import select
import signal
import time
import traceback
import weakref
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from lidarnaut.envs.processes import follow_parent

from .shard import Shard

SPIN_TIME = 0.002
UNGUARDED = "; on Windows, macOS and Python 3.14 workers import the script, which needs `if __name__ == '__main__':`"
_processes = weakref.WeakSet[Any]()
if hasattr(os, "register_at_fork"):  # a forked process would end its parent's workers at exit
    os.register_at_fork(after_in_child=lambda: multiprocessing.process._children.difference_update(_processes))  # type: ignore[attr-defined]


class Worker:
    """Worker process that steps a part of the sub-environments."""

    def __init__(self, context: Any, make_shards: Sequence[Callable[[], Shard]]) -> None:
        self._pipe, far_end = context.Pipe()
        self.process = context.Process(target=serve, args=(far_end, make_shards), daemon=True)
        try:
            self.process.start()
        except ConnectionError as error:  # fork server that has imported the script
            raise RuntimeError(f"no worker process could be started{UNGUARDED}") from error
        _processes.add(self.process)
        far_end.close()
        self.close = weakref.finalize(self, _stop, self._pipe, self.process, os.getpid())

    def send(self, request: bytes) -> None:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # `receive` reports it
            self._pipe.send_bytes(request)

    def receive(self, dtype: np.dtype | None) -> Any:
        """Return the results of the last request, one per shard; as one array for records alone; or the exception."""
        try:
            answer = receive(self._pipe)
        except (EOFError, ConnectionResetError):
            self.process.join()
            hint = UNGUARDED if self.process.exitcode == 1 and self.process._start_method != "fork" else ""
            return RuntimeError(f"a worker process died with exit code {self.process.exitcode}{hint}")
        if answer[:1] == b".":
            return np.frombuffer(answer, dtype, offset=1)
        try:
            content = pickle.loads(answer[1:])
        except Exception as error:
            return error
        if answer[:1] == b"!":
            content, lines = content
            content.add_note(f"in a worker process:\n{lines}")
        return content


def _stop(pipe: Any, process: Any, owner: int) -> None:
    if os.getpid() != owner:  # a forked process does not own the worker
        return
    # Closing is not enough: later forks hold copies of this end.
    with contextlib.suppress(OSError):
        pipe.send_bytes(b"q")
    pipe.close()
    process.join(timeout=10.0)
    if process.is_alive():
        process.kill()


def receive(pipe: Connection) -> bytes:
    """Return the next message of a pipe. Polls up to 2 ms before sleeping, since waking up takes as long as a step."""
    if hasattr(select, "poll"):  # not on Windows
        poll = select.poll()
        poll.register(pipe.fileno(), select.POLLIN)
        end = time.perf_counter() + SPIN_TIME
        while not poll.poll(0) and time.perf_counter() < end:
            os.sched_yield()  # may run on this core
    return pipe.recv_bytes()


def serve(pipe: Connection, make_shards: Sequence[Callable[[], Shard]]) -> None:
    """Answer requests in a worker process until the request b"q".

    The first byte of an answer is "." for `info` as a structured array, "+" for pickled results, and "!" for an error.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    multiprocessing.current_process().daemon = False  # user code may start processes
    follow_parent()
    shards: list[Shard] = []
    with contextlib.suppress(EOFError, ConnectionError):
        while (request := receive(pipe)) != b"q":
            try:
                shards = shards or [make_shard() for make_shard in make_shards]
                if request == b"s":
                    results = [shard.step() for shard in shards]
                    is_plain = not any(extras for _, extras in results)
                    answer = b"." + b"".join(rows.tobytes() for rows, _ in results) if is_plain else b""
                    answer = answer or b"+" + pickle.dumps(results)
                else:
                    method, args = pickle.loads(request)
                    answer = b"+" + pickle.dumps([getattr(shard, method)(*own) for shard, own in zip(shards, args)])
            except Exception as error:
                answer = b"!" + pickle.dumps((_portable(error), traceback.format_exc()))
            pipe.send_bytes(answer)
    for shard in shards:
        shard.close()


def _portable(error: Exception) -> Exception:
    with contextlib.suppress(Exception):
        if isinstance(pickle.loads(pickle.dumps(error)), Exception):
            return error
    return RuntimeError(f"{type(error).__name__}: {error}")
