import contextlib
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .names import printable

MAX_BYTES = 2**31
"""Maximum size of a file, and of the unpacked arrays of an archive [bytes]."""


def check_file(path: str | Path, limit: float = MAX_BYTES) -> None:
    """Check that a path is a regular file of at most `limit` bytes.

    Raises:
        OSError: the file does not exist.
        ValueError: the file is too large or not regular.
    """
    found = Path(path).stat()
    if not stat.S_ISREG(found.st_mode):
        raise ValueError(f"{path}: is not a regular file")
    if found.st_size > limit:
        raise ValueError(f"{path}: {found.st_size:,} bytes; at most {limit:,} are allowed")


def read_bytes(path: str | Path, limit: int = MAX_BYTES) -> bytes:
    """Return the content of a regular file of at most `limit` bytes; ValueError for other files."""
    check_file(path, limit)
    return Path(path).read_bytes()


@contextlib.contextmanager
def open_archive(path: str | Path, what: str = "", hint: str = "") -> Iterator[Any]:
    """Open a NumPy archive (.npz) as a context manager.

    Raises:
        OSError: the file cannot be read.
        ValueError: the archive is damaged or too large, or the `with` block failed. `what` (expected content) and
            `hint` (advice) are part of the message.
    """
    try:
        check_file(path)
        # np.load may leave files open.
        with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as archive:
            if (size := sum(entry.file_size for entry in archive.zip.infolist())) > MAX_BYTES:
                raise ValueError(f"unpacks to {size:,} bytes; at most {MAX_BYTES:,} are allowed")
            yield archive
    except OSError:
        raise
    except Exception as error:  # NumPy, zipfile and zlib raise many types
        said = printable(" ".join(str(error).split())) or type(error).__name__
        raise ValueError(f"{path} is not a {what} ({said}); {hint}" if what else f"{path}: {said}") from error
