"""Progress bars for terminals, files and pipes."""

import os
import threading
import time
from typing import Any

from tqdm import tqdm

from lidarnaut.envs.files import printable


class Progress(tqdm):
    """Progress bar of tqdm; without a terminal it prints a line every ten seconds, and one when it is closed."""

    _due = 0.0
    rate: float | None = None
    """Units per second of the estimate; None estimates from all updates, 0 shows no estimate."""

    @property
    def format_dict(self) -> dict[str, Any]:
        return {**super().format_dict, **({} if self.rate is None else {"rate": self.rate})}

    def __str__(self) -> str:
        return printable(super().__str__())

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:  # type: ignore[override]
        if self.fp.isatty():
            return bool(super().display(msg, pos))
        # The final call has a position.
        is_last, now = msg is None and pos is not None, time.monotonic()
        if is_last or (msg is None and now >= self._due and self.n != self.total):
            self._due = now + 10.0
            self.fp.write(str(self) if is_last else f"{self}\n")
            self.fp.flush()
        return False

    def note(self) -> None:
        """Show the current state; without a terminal, in a line of its own."""
        self._due = 0.0
        self.refresh()

    def close(self) -> None:
        if not self.disable and not self.fp.isatty():
            self.leave = True  # nothing can be erased
        super().close()

    def clear(self, *args: Any, **kwargs: Any) -> None:
        if not self.disable and self.fp.isatty():
            super().clear(*args, **kwargs)


def _make_lock() -> None:
    """Replace tqdm's lock between processes, which a killed process never releases, by a thread lock."""
    Progress.set_lock(threading.RLock())


_make_lock()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_make_lock)
