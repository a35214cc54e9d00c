"""Compiled kernels: where they are kept, by which process each is made, and a progress bar meanwhile."""

import contextlib
import gc
import hashlib
import logging
import multiprocessing
import os
import re
from collections.abc import Iterator
from functools import cache
from typing import Any

import numba
from numba.core import caching, event
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from tqdm import tqdm

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_log = logging.getLogger("lidarnaut")
_ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
_OWN = re.compile(r"lidarnaut\b")
_IMPORT = re.compile(r"^(?:from|import) +(\.*)([\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


class SourceLocator(caching._SourceFileBackedLocatorMixin, caching._CacheLocator):
    """Lets Numba keep kernels in the user's cache folder, by their source and that of all modules they import.

    By itself Numba keeps them beside their file and compares that file alone: each new checkout compiles all of them
    again, and an outdated kernel stays in use where another one that it calls has changed. The folder is
    `NUMBA_CACHE_DIR`, or `lidarnaut` in `XDG_CACHE_HOME` or `~/.cache`; where it cannot be written, Numba's own apply.
    """

    def __init__(self, py_func: Any, py_file: str) -> None:
        self._py_file, self._lineno = py_file, py_func.__code__.co_firstlineno

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        """Return the locator of a function, None where it is not one of this project or nothing can be written."""
        return super().from_function(py_func, py_file) if _OWN.match(_name(py_file)) else None

    def get_cache_path(self) -> str:
        home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
        folder = numba.config.CACHE_DIR or os.path.join(home, "lidarnaut")  # type: ignore[attr-defined]
        return os.path.join(folder, f"{_name(self._py_file)}-{self.get_source_stamp()[:16]}")

    def get_source_stamp(self) -> str:
        return _hash(self._py_file)


class _Progress(event.Listener):
    """Announces once that kernels compile, and counts them where standard error is a terminal."""

    def __init__(self) -> None:
        self._depth = 0
        self._bar: Any = None

    def on_start(self, event: Any) -> None:
        self._depth += 1
        if self._depth > 1 or not _OWN.match(str(event.data["dispatcher"].py_func.__module__)):
            return
        if self._bar is None:
            if not multiprocessing.current_process().daemon:  # workers that compile what their parent does
                _log.warning("compiling kernels for this machine, once: it takes one to two minutes")
            is_off = True if multiprocessing.parent_process() else None  # None: if this is no terminal
            self._bar = tqdm(bar_format="compiling: {n} kernels [{elapsed}]", leave=False, disable=is_off)
        self._bar.refresh()

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._bar is not None:
            self._bar.update()
            if self._depth == 0:
                self._bar.clear()  # whatever is printed next begins on a clean line


def sources(path: str) -> list[str]:
    """Return a file and those of this project that it, or one of them, imports at its top level."""
    found, new = {path}, {path}
    while new:
        new = {other for one in new for other in _read(one)[1]} - found
        found |= new
    return sorted(found)


@cache
def _hash(path: str) -> str:
    """Return the hash of all that may shape the kernels of a file: code and constants of what it imports, and Numba."""
    parts = (f"{_name(source)}\n{_read(source)[0]}" for source in sources(path))
    return hashlib.sha256("\n".join([numba.__version__, *parts]).encode()).hexdigest()


@cache
def _read(path: str) -> tuple[str, list[str]]:
    """Return the text of a file, and the files of this project that it imports at its top level."""
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
    """Return the name of the module in a file of this project."""
    return path.removeprefix(_ROOT + os.sep).removesuffix(".py").replace(os.sep, ".")


def _compile(dispatcher: Any, sig: Any, compile: Any = Dispatcher.compile) -> Any:
    """Compile a kernel in one process; others that need it, too, wait until it is kept, and load it."""
    if not (dispatcher._cache.cache_path and _OWN.match(dispatcher.py_func.__module__)):
        return compile(dispatcher, sig)
    path = os.path.join(dispatcher._cache.cache_path, f".{dispatcher._cache._impl.filename_base}")
    with global_compiler_lock, _lock(path), _garbage_kept():  # Numba's lock first: threads take both in one order
        return compile(dispatcher, sig)


@contextlib.contextmanager
def _lock(path: str) -> Iterator[None]:
    """Wait until no other process holds the lock of a file, and hold it; where there are no locks, go on.

    Not by `lidarnaut.envs.files.Lock`: an edit of what this module imports would have all kernels compiled again.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # a folder removed meanwhile, or a file system without locks
            file = stack.enter_context(open(path, "w"))
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX)
        yield


@contextlib.contextmanager
def _garbage_kept() -> Iterator[None]:
    """Put the garbage collector off, which takes a good part of a compilation's time and finds little."""
    is_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if is_on:
            gc.enable()


def _load_index(file: Any, load: Any = caching.IndexDataCacheFile._load_index) -> dict[Any, str]:
    """Return the kernels of a file that are kept; none where a record that one takes is in another module now."""
    try:
        return load(file)
    except (ImportError, AttributeError):
        return {}


caching.IndexDataCacheFile._load_index = _load_index  # type: ignore[method-assign]
Dispatcher.compile = _compile  # type: ignore[method-assign, assignment]
caching.CacheImpl._locator_classes.insert(0, SourceLocator)
event.register("numba:compile", _Progress())
