"""NumPy archives of a limited size."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

MAX_BYTES = 2**31
"""Largest arrays of an archive together [bytes]; a small file can unpack to any size."""


@contextlib.contextmanager
def open_archive(path: Path) -> Iterator[Any]:
    """Open an archive (.npz) as `np.load` does; ValueError if it unpacks to more than `MAX_BYTES`."""
    # NumPy leaves a file open that is no archive, but not one that was opened for it.
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        if (size := sum(entry.file_size for entry in archive.zip.infolist())) > MAX_BYTES:
            raise ValueError(f"unpacks to {size:,} bytes; at most {MAX_BYTES:,} are allowed")
        yield archive
