"""Compilation of Numba kernels: cache on disk, lock between processes, and progress bar."""

import contextlib
import errno
import gc
import hashlib
import logging
import multiprocessing
import os
import pickle
import platform
import re
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from typing import Any

import numba
from numba.core import caching, event
from numba.core.compiler import CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps
from tqdm import tqdm

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

NAME_HOLDER_AFTER, GIVE_UP_AFTER = 10.0, 60.0
"""Waiting times [s] while another process compiles a kernel: until a warning, and until also compiling here."""
_log = logging.getLogger("lidarnaut")
_warned: set[tuple[str, str]] = set()
_USER = os.geteuid() if hasattr(os, "geteuid") else None
_ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
_OWN = re.compile(r"lidarnaut\b")
_IMPORT = re.compile(r"^(?:from|import) +(\.*)([\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


class KernelCache(caching.NullCache):
    """Disk cache of compiled Numba kernels, with one file per signature.

    Unlike in Numba's cache, changes of called kernels also invalidate an entry. The folder is `NUMBA_CACHE_DIR`, or
    `lidarnaut` in `XDG_CACHE_HOME` or `~/.cache`, or the temporary folder `lidarnaut-UID`. Loading executes the file:
    other users must not have write access.
    """

    def __init__(self, py_func: Any) -> None:
        source, line = py_func.__code__.co_filename, py_func.__code__.co_firstlineno
        self._module = f"{_name(source)}-{_hash(source)[:16]}"
        self._kernel = f"{py_func.__qualname__}-{line}.{sys.implementation.cache_tag}"
        home = os.environ.get("XDG_CACHE_HOME", "")
        home = home if os.path.isabs(home) else os.path.join(os.path.expanduser("~"), ".cache")
        named = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        self._base, self._closed = os.path.realpath(named or os.path.join(home, "lidarnaut")), 0o002
        try:
            if not named and not os.path.isabs(home):
                raise OSError(errno.ENOENT, "the home folder is unknown", home)
            self.path()
        except OSError as error:
            self._base, self._closed = os.path.join(tempfile.gettempdir(), f"lidarnaut-{_USER}"), 0o077
            self.path()
            if multiprocessing.parent_process() is None:  # workers are silent
                _warn("compiled kernels are kept in %s: %s", self._base, error)

    def path(self, key: Any = None) -> str:
        """Return the path of the cache file for a key, or of the lock file; raise OSError if unsafe."""
        for folder in (self._base, os.path.join(self._base, self._module)):
            os.makedirs(folder, 0o755 & ~self._closed, exist_ok=True)
            state = os.lstat(folder)
            is_closed = state.st_mode & stat.S_ISVTX or not state.st_mode & self._closed
            is_own = _USER is None or (state.st_uid in (0, _USER) and is_closed)
            if not is_own or not stat.S_ISDIR(state.st_mode):
                raise OSError(errno.EPERM, "it is a symbolic link, or another user owns it or may write to it", folder)
        end = "lock" if key is None else f"{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"
        return os.path.join(folder, f"{self._kernel}.{end}")

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        target_context.refresh()
        key, path = (sig, target_context.codegen().magic_tuple()), self._base
        try:
            path = self.path(key)
            with open(path, "rb") as file:
                digest, content = file.read(32), file.read()
            if hashlib.sha256(content).digest() != digest:
                raise ValueError("it is damaged")
            kept, code = pickle.loads(content)
            return CompileResult._rebuild(target_context, *code) if kept == key else None
        except (FileNotFoundError, ImportError, AttributeError):  # or a class was moved
            pass
        except Exception as error:
            _warn("%s is compiled again: %s", path, error)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        if data.library.has_dynamic_globals:
            return
        key, path = (sig, data.codegen.magic_tuple()), self._base
        content = dumps((key, data._reduce()))
        try:
            path = self.path(key)
            with open(f"{path}.{os.getpid()}", "wb") as file:
                file.write(hashlib.sha256(content).digest() + content)
            os.replace(file.name, path)
        except OSError as error:
            _warn("%s is not kept: %s", path, error)
            with contextlib.suppress(OSError):
                os.remove(f"{path}.{os.getpid()}")


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


def sources(path: str) -> list[str]:
    """Return a file and all project files that it imports, directly or indirectly."""
    found, new = {path}, {path}
    while new:
        new = {other for one in new for other in _read(one)[1]} - found
        found |= new
    return sorted(found)


@cache
def _hash(path: str) -> str:
    parts = (f"{_name(source)}\n{_read(source)[0]}" for source in sources(path))
    return hashlib.sha256("\n".join([numba.__version__, *parts]).encode()).hexdigest()


@cache
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
    return text, list(filter(os.path.isfile, files))


def _name(path: str) -> str:
    return path.removeprefix(_ROOT + os.sep).removesuffix(".py").replace(os.sep, ".")


def _enable_caching(dispatcher: Any, enable: Any = Dispatcher.enable_caching) -> None:
    if not _OWN.match(_name(dispatcher.py_func.__code__.co_filename)):
        return enable(dispatcher)
    try:
        dispatcher._cache = KernelCache(dispatcher.py_func)
    except OSError as error:
        _warn("compiled kernels, such as those of %s, are not kept: %s", dispatcher.py_func.__module__, error)


def _compile(dispatcher: Any, sig: Any, compile: Any = Dispatcher.compile) -> Any:
    if not isinstance(dispatcher._cache, KernelCache):
        return compile(dispatcher, sig)
    with global_compiler_lock, _lock(dispatcher, sig):
        is_on = gc.isenabled()
        gc.disable()
        try:
            return compile(dispatcher, sig)
        finally:
            if is_on:
                gc.enable()


@contextlib.contextmanager
def _lock(dispatcher: Any, sig: Any) -> Iterator[None]:
    """Hold a kernel's file lock until the kernel is cached, if locks are available.

    Does not use `lidarnaut.envs.files.Lock`, because edits of that file would recompile all kernels.
    """
    cache, begin = dispatcher._cache, time.monotonic()
    hangs = "the lock %s stays with %s: this process compiles the kernel, too"
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError, AttributeError):  # no folder, disk space or locks; Windows
            path, kept = cache.path(), cache.path((sig, dispatcher.targetctx.codegen().magic_tuple()))
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
            stack.callback(os.close, descriptor)
            while not os.path.exists(kept):
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    os.ftruncate(descriptor, 0)
                    os.write(descriptor, f"process {os.getpid()} on {platform.node()}".encode())
                    break
                except BlockingIOError:
                    holder = os.pread(descriptor, 300, 0).decode(errors="replace") or "another process"
                waited = time.monotonic() - begin
                if waited > GIVE_UP_AFTER or (hangs, holder) in _warned:
                    _warn(hangs, path, holder)
                    break
                if waited > NAME_HOLDER_AFTER:
                    _warn("waiting for the lock %s of %s, which compiles a kernel", path, holder)
                time.sleep(0.01)
        yield


def _warn(text: str, subject: str, reason: object) -> None:
    cause = text, str(getattr(reason, "strerror", None) or reason)
    if cause not in _warned:
        _warned.add(cause)
        _log.warning(text, subject, reason)


Dispatcher.enable_caching = _enable_caching  # type: ignore[method-assign, assignment]
Dispatcher.compile = _compile  # type: ignore[method-assign, assignment]
event.register("numba:compile", _Progress())
