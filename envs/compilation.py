"""Compilation of the package's Numba kernels: `njit` with a disk cache, and a progress bar.

Nothing in Numba is replaced: kernels of other packages are compiled and kept as without this package.
"""

import contextlib
import hashlib
import logging
import multiprocessing
import os
import pickle
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache as cached
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import caching, event
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
from tqdm import tqdm

MAX_AGE = 30 * 86400.0
"""Folders of compiled kernels are deleted after this time without use [s]."""
_log = logging.getLogger("lidarnaut")
_USER = os.geteuid() if hasattr(os, "geteuid") else None
_ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
_warned: set[str] = set()
_OWN = re.compile(r"lidarnaut\b")
_IMPORT = re.compile(r"^(?:from|import) +(\.*)([\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


def njit(*, cache: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return the decorator `numba.njit(**options)`; with `cache`, kernels are kept by a `KernelCache`."""

    def decorate(function: Callable[..., Any]) -> Any:
        kernel = numba.njit(**options)(function)
        if cache and kernel is not function and (base := _base()):  # with NUMBA_DISABLE_JIT=1 it is the function
            kernel._cache = KernelCache(function, base)
        return kernel

    return decorate


class KernelCache(caching.NullCache):
    """Disk cache of a kernel, with one file per signature, in a folder for each version of its module.

    A version is the text of the module and of all that it imports, so that changes of called kernels and of constants
    count, too. A file that is damaged or cannot be written is no error. Loading executes the file.
    """

    def __init__(self, function: Any, base: Path) -> None:
        code, tag = function.__code__, sys.implementation.cache_tag
        self._folder = _folder(base, code.co_filename)
        self._kernel = f"{function.__qualname__}-{code.co_firstlineno}.{tag}"

    @property
    def cache_path(self) -> str:
        return str(self._folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        target_context.refresh()
        path = self._path(key := (sig, target_context.codegen().magic_tuple()))
        try:
            content = path.read_bytes()
            if hashlib.sha256(content[32:]).digest() != content[:32]:
                raise ValueError("it is damaged")
            kept, code = pickle.loads(content[32:])
            return CompileResult._rebuild(target_context, *code) if kept == key else None
        except (FileNotFoundError, ImportError, AttributeError):  # or a class was moved
            return None
        except Exception as error:
            _warn("%s is compiled again: %s", path, error)
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        if data.library.has_dynamic_globals:
            return
        path = self._path(key := (sig, data.codegen.magic_tuple()))
        content, own = dumps((key, data._reduce())), Path(f"{path}.{os.getpid()}")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            own.write_bytes(hashlib.sha256(content).digest() + content)
            own.replace(path)  # whole, also for processes that compile the same kernel
        except OSError as error:
            _warn("%s is not kept: %s", path, error)
            with contextlib.suppress(OSError):
                own.unlink()

    def _path(self, key: Any) -> Path:
        return self._folder / f"{self._kernel}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"


class _Progress(event.Listener):
    def __init__(self) -> None:
        self._depth = 0
        self._bar: Any = None

    def on_start(self, event: Any) -> None:
        self._depth += 1
        if self._depth > 1 or not _OWN.match(str(event.data["dispatcher"].py_func.__module__)):
            return
        if self._bar is None:
            if not multiprocessing.current_process().daemon:
                _log.warning("compiling kernels for this machine, which takes one to two minutes the first time")
            is_off = True if multiprocessing.parent_process() else None
            self._bar = tqdm(bar_format="compiling: {n} kernels [{elapsed}]", leave=False, disable=is_off)
        self._bar.refresh()

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._bar is not None:
            self._bar.update()
            if self._depth == 0:
                self._bar.clear()


event.register("numba:compile", _Progress())


@cached
def _base() -> Path | None:
    """Return the cache folder: the usual or a temporary one, if no other user can write to it; otherwise None."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    home = home if os.path.isabs(home) else os.path.expanduser("~/.cache")
    named = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    temporary, reason = Path(tempfile.gettempdir(), f"lidarnaut-{_USER}"), None
    for folder in (Path(os.path.realpath(named)) if named else Path(home, "lidarnaut"), temporary):
        try:
            if not folder.is_absolute():
                raise OSError("the home folder is unknown")
            folder.mkdir(0o755, parents=True, exist_ok=True)
            state = folder.lstat()
            is_closed = state.st_mode & stat.S_ISVTX or not state.st_mode & 0o002
            is_own = _USER is None or (state.st_uid in (0, _USER) and is_closed)
            if not is_own or not stat.S_ISDIR(state.st_mode):
                raise OSError(f"{folder} is a symbolic link, or another user owns it or may write to it")
            if reason:
                _warn("compiled kernels are kept in %s: %s", folder, reason)
            return folder
        except OSError as error:
            reason = error
    _warn("compiled kernels are not kept in %s: %s", temporary, reason)
    return None


@cached
def _folder(base: Path, source: str) -> Path:
    """Return the folder of a module's kernels, and delete old folders if there is none yet."""
    texts = [(_name(path), _read(path)[0]) for path in sources(source)]
    version = hashlib.sha256(repr((numba.__version__, np.__version__, texts)).encode()).hexdigest()
    folder = base / f"{_name(source)}-{version[:16]}"
    with contextlib.suppress(OSError):  # a folder that another user fills
        for other in [] if folder.exists() else base.glob("lidarnaut.*-*"):
            if time.time() - other.stat().st_mtime > MAX_AGE:
                shutil.rmtree(other, ignore_errors=True)
        folder.mkdir(exist_ok=True)
        os.utime(folder)
    return folder


def sources(path: str) -> list[str]:
    """Return a file and all project files that it imports, directly or indirectly."""
    found, new = {path}, {path}
    while new:
        new = {other for one in new for other in _read(one)[1]} - found
        found |= new
    return sorted(found)


@cached
def _read(path: str) -> tuple[str, list[str]]:
    with open(path, encoding="utf-8") as file:
        text = file.read()
    stems = []
    for dots, module, names in _IMPORT.findall(text):
        if dots or _OWN.match(module):
            folder = os.path.normpath(os.path.join(path, *[".."] * len(dots))) if dots else _ROOT
            stem = os.path.join(folder, *module.split("."))
            stems += [stem, *(os.path.join(stem, name) for name in re.findall(r"\b[a-z]\w*", names))]
    files = (stem + end for stem in stems for end in (".py", f"{os.sep}__init__.py"))
    return hashlib.sha256(text.encode()).hexdigest(), list(filter(os.path.isfile, files))


def _name(path: str) -> str:
    return path.removeprefix(_ROOT + os.sep).removesuffix(".py").replace(os.sep, ".")


def _warn(text: str, path: Path, error: Exception | None) -> None:
    if text not in _warned and multiprocessing.parent_process() is None:  # workers are silent
        _log.warning(text, path, error)
    _warned.add(text)
