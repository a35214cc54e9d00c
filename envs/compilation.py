"""A note to users while kernels compile in the first step."""

import logging
from functools import cache
from pathlib import Path
from typing import Any

_log = logging.getLogger("lidarnaut")


@cache
def announce_compilation(kernel: Any) -> None:
    """Log, once in a process, that kernels will be compiled, unless `kernel` and with it the others already were.

    Args:
        kernel: a Numba function that keeps its compiled form in a cache on disk.
    """
    name = f"{Path(kernel.py_func.__code__.co_filename).stem}.{kernel.py_func.__qualname__}"
    if not any(Path(kernel.stats.cache_path).glob(f"{name}-*.nbi")):
        _log.warning("compiling the kernels for this machine; this happens once and takes up to half a minute")
