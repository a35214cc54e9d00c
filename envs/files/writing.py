import contextlib
import os
import platform
import re
import shutil
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

_STARTED = time.time()
_cleaned: set[Path] = set()


def write_file(path: str | Path, content: bytes | str) -> None:
    """Write a file atomically. After an OSError, the old file is unchanged."""
    with _in_place_of(Path(path)) as temporary:
        _write_through(temporary, content)


def write_folder(path: Path, files: Mapping[str, bytes | str]) -> None:
    """Create a folder with files (content by name) atomically; OSError if the folder has content."""
    with _in_place_of(path) as temporary:
        temporary.mkdir(parents=True)
        for name, content in files.items():
            _write_through(temporary / name, content)
        _sync_folder(temporary)


@contextlib.contextmanager
def _in_place_of(path: Path) -> Iterator[Path]:
    """Yield a temporary path, renamed to `path` if the `with` block succeeds."""
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
    """Append text to a file and sync the file to disk; OSError for a symbolic link."""
    with naming(path):
        _write_through(path, text, "ab")


def own_folder(path: Path, name: str = "") -> Path:
    """Create the folder `path / name` for writing, and return its path.

    Raises:
        ValueError: the folder, or an entry up to two levels below, is a symbolic link.
    """
    folder = path / name
    if not (name and folder.is_symlink()):
        folder.mkdir(parents=True, exist_ok=True)
    for entry in ([folder] if name else []) + [*folder.glob("*"), *folder.glob("*/*")]:
        if entry.is_symlink():
            raise ValueError(f"{entry} is a symbolic link: writing through links is refused; remove it")
    return folder


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def temporary_beside(path: Path) -> Path:
    """Return a temporary path next to `path`, unique across processes and machines.

    The first call for a folder removes temporary files that ended processes of this machine have left.
    """
    if (folder := path.parent.absolute()) not in _cleaned:
        _cleaned.add(folder)
        for other in folder.glob(".*.tmp"):
            match = re.fullmatch(rf"\..*\.{re.escape(platform.node())}\.(\d+)\.tmp", other.name)
            if match is not None and not _is_alive(int(match[1]), other):
                _remove(other)
    return path.with_name(f".{path.name}.{platform.node()}.{os.getpid()}.tmp")


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Context manager that adds `path` to operating system errors without a file name."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def _is_alive(pid: int, path: Path) -> bool:
    if pid == os.getpid():
        with contextlib.suppress(FileNotFoundError):  # another thread has just renamed it
            return path.stat().st_mtime > _STARTED - 1.0
        return False
    try:
        os.kill(pid, 0)
    except (OSError, OverflowError) as error:  # not permitted: process of another user
        return not isinstance(error, ProcessLookupError)
    return True


def _write_through(path: Path, content: bytes | str, mode: Literal["xb", "ab"] = "xb") -> None:
    with open(path, mode, opener=lambda p, flags: os.open(p, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)) as file:
        file.write(content.encode() if isinstance(content, str) else content)
        file.flush()
        os.fsync(file.fileno())


def _sync_folder(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
