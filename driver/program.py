"""What programs that drive robots share: time of the robot, signals, time limits, and a log that never waits."""

import contextlib
import faulthandler
import logging
import math
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator
from logging.handlers import QueueHandler, QueueListener
from typing import Any

from lidarnaut.envs.command_line import run_command

SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that end a program like Ctrl-C."""


class Clock:
    """Time of the robot's messages, between messages and without synchronized computers.

    The offset between stamps and the local clock is the largest one of the last `WINDOW` seconds, which belongs to the
    fastest message; a delay that all messages share cannot be seen. Pauses without a message do not count, so that
    messages that have waited while this program stood still are known to be old.
    """

    WINDOW, PAUSE = 10.0, 0.5

    def __init__(self) -> None:
        self._offsets: list[tuple[float, float]] = []
        self._noted = self._paused = 0.0

    def note(self, stamp: float) -> None:
        """Note the stamp of a message that has just arrived [s]."""
        now = time.monotonic()
        if self._offsets and now - self._noted > self.PAUSE:
            self._paused += now - self._noted
        self._noted, active, offset = now, now - self._paused, stamp - now
        kept = [each for each in self._offsets if active - each[0] < self.WINDOW and each[1] > offset]
        self._offsets = [*kept, (active, offset)]

    @property
    def time(self) -> float:
        """Estimated time of the robot's clock [s]; NaN before the first message."""
        return time.monotonic() + self._offsets[0][1] if self._offsets else math.nan


@contextlib.contextmanager
def time_limited(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in the main thread if the body takes longer; end the process if it then goes on for as long.

    The second limit is for compiled code, which Python cannot interrupt.
    """

    def interrupt(*_: Any) -> None:
        raise TimeoutError(f"a decision takes over {seconds:g} s")

    if not hasattr(signal, "setitimer"):
        yield
        return
    signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    faulthandler.dump_traceback_later(2.0 * seconds, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def first_signal() -> threading.Event:
    """Return an event that the next signal sets, instead of raising KeyboardInterrupt as the ones after it do.

    An exception at any place of a loop may leave a lock taken, or be lost in a callback of the interpreter.
    """
    is_over = threading.Event()

    def note(number: int, frame: Any) -> None:
        if is_over.is_set():
            signal.default_int_handler(number, frame)
        is_over.set()

    if threading.current_thread() is threading.main_thread():
        handle_signals(note)
    return is_over


def handle_signals(handler: Any) -> None:
    """Set the handler of `SIGNALS`, except for those that are ignored, as with nohup."""
    for each in SIGNALS:
        if signal.getsignal(each) != signal.SIG_IGN:
            signal.signal(each, handler)


def run_program(main: Callable[[Any], None], options: type) -> None:
    """Run a program with options of the command line; SIGTERM and SIGHUP end it like Ctrl-C.

    Messages are printed by a thread of its own: a terminal that stands still, or is gone, holds nothing up.
    """
    records = queue.Queue[Any](1000)
    logging.raiseExceptions = False
    QueueListener(records, logging.StreamHandler()).start()
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[QueueHandler(records)])
    handle_signals(signal.default_int_handler)
    status: Any = 1
    try:
        run_command(main, options=options, status=1)
        status = 0
    except SystemExit as stop:
        status = int(stop.code or 0)
        raise
    finally:
        end = time.monotonic() + 1.0
        while not records.empty() and time.monotonic() < end:
            time.sleep(0.01)
        if any(not each.daemon for each in threading.enumerate() if each is not threading.main_thread()):
            os._exit(status)  # threads of a policy would keep the program for ever
