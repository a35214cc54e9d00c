"""Files of a limited size: bytes, and NumPy archives."""

import contextlib
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .names import printable

MAX_BYTES = 2**31
"""Largest file, and largest arrays of an archive together [bytes]; a small archive can unpack to any size."""


def check_file(path: Path, limit: float = MAX_BYTES) -> None:
    """Refuse a file that is not regular, such as a named pipe, which may never end, or larger than `limit` [bytes].

    Raises:
        OSError: there is no such file.
        ValueError: it is refused; names it.
    """
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise ValueError(f"{path}: is no regular file")
    if found.st_size > limit:
        raise ValueError(f"{path}: {found.st_size:,} bytes; at most {limit:,} are allowed")


def read_bytes(path: Path, limit: int = MAX_BYTES) -> bytes:
    """Read a regular file of at most `limit` bytes; raises as `check_file`."""
    check_file(path, limit)
    return path.read_bytes()


@contextlib.contextmanager
def open_archive(path: Path, what: str = "", hint: str = "") -> Iterator[Any]:
    """Open an archive (.npz) as `np.load` does, for a block that reads it.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is damaged, unpacks to more than `MAX_BYTES`, or the block raises an error; names the file, says
            `what` it should be, and gives the hint.
    """
    try:
        check_file(path)
        # NumPy leaves a file open that is no archive, but not one that was opened for it.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            if (size := sum(entry.file_size for entry in archive.zip.infolist())) > MAX_BYTES:
                raise ValueError(f"unpacks to {size:,} bytes; at most {MAX_BYTES:,} are allowed")
            yield archive
    except OSError:
        raise
    except Exception as error:  # NumPy, zipfile and zlib raise many kinds
        said = printable(" ".join(str(error).split())) or type(error).__name__
        raise ValueError(f"{path} is no {what} ({said}); {hint}" if what else f"{path}: {said}") from error
