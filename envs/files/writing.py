"""Files that are either whole or absent."""

import contextlib
import os
import platform
import re
import shutil
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

_STARTED = time.time()
_swept: set[Path] = set()
"""Folders that this process has swept."""


def write_file(path: Path, content: bytes | str) -> None:
    """Replace `path` by `content`; a reader, also after a crash, finds the old content or the new, never a part.

    Raises:
        OSError: if it cannot be written; the old file is still there, and nothing is left beside it.
    """
    with _in_place_of(path) as temporary:
        _write_through(temporary, content)


def write_folder(path: Path, files: Mapping[str, bytes | str]) -> None:
    """Create the folder `path` with `files` in it, all of them or nothing; OSError also if it exists already."""
    with _in_place_of(path) as temporary:
        temporary.mkdir(parents=True)
        for name, content in files.items():
            _write_through(temporary / name, content)
        _sync_folder(temporary)


@contextlib.contextmanager
def _in_place_of(path: Path) -> Iterator[Path]:
    """Take what a block writes beside `path` to there, if the block succeeds."""
    temporary = temporary_beside(path)
    _remove(temporary)
    try:
        with naming(path):
            yield temporary
            os.replace(temporary, path)
    except BaseException:
        _remove(temporary)
        raise
    _sync_folder(path.parent)


def append_file(path: Path, text: str) -> None:
    """Append to a file, which is created if needed, and see it to the disk; OSError also if it is a symbolic link."""
    with naming(path), open(path, "a", newline="", encoding="utf-8", opener=_open_itself) as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def own_folder(path: Path, name: str = "") -> Path:
    """Create a folder that is to be written in, or the folder `name` in it; return it.

    Raises:
        ValueError: the folder `name`, an entry, or an entry one level below is a symbolic link: a folder from elsewhere
            could let its links point to any file. `path` may be a link.
    """
    folder = path / name
    if not (name and folder.is_symlink()):
        folder.mkdir(parents=True, exist_ok=True)
    for entry in ([folder] if name else []) + [*folder.glob("*"), *folder.glob("*/*")]:
        if entry.is_symlink():
            raise ValueError(f"{entry} is a symbolic link: nothing is written through links; remove it")
    return folder


def _open_itself(path: str, flags: int) -> int:
    """Open a file for writing; OSError if it is a symbolic link."""
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


def _remove(path: Path) -> None:
    """Remove a file or a folder, if it is there; of a symbolic link, the link."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def temporary_beside(path: Path) -> Path:
    """Return a name next to `path` that no other process uses, on this machine or on one that shares the folder.

    Before the first one in a folder, remove temporary files of killed processes there, see `sweep`.
    """
    if (folder := path.parent.absolute()) not in _swept:
        _swept.add(folder)
        sweep(folder)
    return path.with_name(f".{path.name}.{platform.node()}.{os.getpid()}.tmp")


def sweep(folder: Path) -> None:
    """Remove temporary files and folders of `temporary_beside` whose processes, of this machine, no longer run."""
    for path in folder.glob(".*.tmp"):
        match = re.fullmatch(rf"\..*\.{re.escape(platform.node())}\.(\d+)\.tmp", path.name)
        if match is not None and not _is_alive(int(match[1]), path):
            _remove(path)


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let errors of the operating system that name no file name `path`: of a full disk, Python says nothing more."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def _is_alive(pid: int, path: Path) -> bool:
    """Return whether the process that made a temporary file runs; of an older process with this one's number, no."""
    if pid == os.getpid():
        with contextlib.suppress(FileNotFoundError):  # another thread has just put it in its place
            return path.stat().st_mtime > _STARTED - 1.0
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's
        return True
    return True


def _write_through(path: Path, content: bytes | str) -> None:
    """Write a file and wait until it lies on the disk."""
    with open(path, "xb", opener=_open_itself) as file:
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
