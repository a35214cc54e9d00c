import os
import platform
from pathlib import Path

from .archives import check_file
from .names import printable

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


class LockedError(RuntimeError):
    """Error for a lock that another process holds."""


class Lock:
    """Lock on a folder as a context manager, released when the process ends.

    No effect on systems without file locks.
    """

    def __init__(self, folder: Path, name: str = "lock", *, shared: bool = False) -> None:
        """Prepare a lock on the file `.<name>` in a folder. Several processes can hold a `shared` lock."""
        self._folder, self._path, self._shared = folder, folder / f".{name}", shared
        self._descriptor = -1

    def __enter__(self) -> "Lock":
        """Acquire the lock.

        Raises:
            LockedError: another process holds the lock.
            ValueError: the lock file is not a regular file.
        """
        if fcntl is None:
            return self
        if self._path.exists():
            check_file(self._path)
        descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(descriptor, (fcntl.LOCK_SH if self._shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = printable(os.read(descriptor, 200).decode(errors="replace")).strip() or "another process"
            os.close(descriptor)
            raise LockedError(f"{self._folder} is in use: {holder} is writing to it") from None
        except OSError:  # a file system without locks
            os.close(descriptor)
            return self
        os.ftruncate(descriptor, 0)
        if not self._shared:
            os.write(descriptor, f"process {os.getpid()} on {platform.node()}\n".encode())
        self._descriptor = descriptor
        return self

    def __exit__(self, *_: object) -> None:
        """Release the lock and keep its file. Removing the file would allow a second lock."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
