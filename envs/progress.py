"""Progress bars, of which files and pipes get whole lines."""

import os
import threading
import time
from typing import Any

from tqdm import tqdm

from lidarnaut.envs.files import printable


class Progress(tqdm):
    """A bar of tqdm; where the output is no terminal, a line every ten seconds, and one at the end if it stays."""

    _due = 0.0

    def __str__(self) -> str:
        """Return the bar as text, with control characters of names escaped."""
        return printable(super().__str__())

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:  # type: ignore[override]
        """Show the bar, or `msg` in its place."""
        if self.fp.isatty():
            return bool(super().display(msg, pos))
        # At its end a bar that stays is shown at a position, and ends the line itself; one that goes is emptied.
        is_last, now = msg is None and pos is not None, time.monotonic()
        if is_last or (msg is None and now >= self._due and self.n != self.total):
            self._due = now + 10.0
            self.fp.write(str(self) if is_last else f"{self}\n")
            self.fp.flush()
        return False

    def clear(self, *args: Any, **kwargs: Any) -> None:
        """Take the bar off the terminal for a moment."""
        if not self.disable and self.fp.isatty():
            super().clear(*args, **kwargs)


def _make_lock() -> None:
    """Give bars a lock of this process alone: a process that is killed in the midst of a bar would keep tqdm's."""
    Progress.set_lock(threading.RLock())


_make_lock()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_make_lock)
