"""Files that are either whole or absent."""

import os
import platform
import shutil
from collections.abc import Mapping
from pathlib import Path


def write_file(path: Path, content: bytes | str) -> None:
    """Replace `path` by `content`; a reader, also after a crash, finds the old content or the new, never a part.

    Raises:
        OSError: if it cannot be written; the old file is still there, and nothing is left beside it.
    """
    temporary = temporary_beside(path)
    try:
        _write_through(temporary, content)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def write_folder(path: Path, files: Mapping[str, bytes | str]) -> None:
    """Create the folder `path` with `files` in it, all of them or nothing.

    Raises:
        OSError: if it cannot be written or exists already; nothing is left beside it.
    """
    temporary = temporary_beside(path)
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        temporary.mkdir(parents=True)
        for name, content in files.items():
            _write_through(temporary / name, content)
        _sync_folder(temporary)
        os.rename(temporary, path)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    _sync_folder(path.parent)


def temporary_beside(path: Path) -> Path:
    """Return a name next to `path` that no other process uses, on this machine or on one that shares the folder."""
    return path.with_name(f".{path.name}.{platform.node()}.{os.getpid()}.tmp")


def _write_through(path: Path, content: bytes | str) -> None:
    """Write a file and wait until it lies on the disk."""
    with open(path, "wb") as file:
        file.write(content.encode() if isinstance(content, str) else content)
        file.flush()
        os.fsync(file.fileno())


def _sync_folder(path: Path) -> None:
    """Wait until the names in a folder lie on the disk: without it, a rename may not survive a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
