"""Run the notebooks in parallel, while other pages are generated and read; myst-nb runs notebooks in sequence."""

import logging
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from jupyter_cache import get_cache
from jupyter_cache.executors import load_executor
from sphinx.application import Sphinx

NOTEBOOKS = "start/tutorials/"
"""Prefix of the names of pages that are notebooks."""
_running: list[subprocess.Popen[bytes]] = []


def start(app: Sphinx) -> None:
    """Start to run all notebooks of `docs/start/tutorials`; not with `-D nb_execution_mode=off`."""
    config = app.config
    if config.nb_execution_mode == "off":
        return
    arguments = app.srcdir, config.nb_execution_cache_path, config.nb_execution_timeout
    _running.append(subprocess.Popen([sys.executable, __file__, *map(str, arguments)], stdout=subprocess.PIPE))


def wait(app: Sphinx, name: str, source: list[str]) -> None:
    """Wait before a notebook is read until all have run. One that failed is run again by myst-nb, which says why.

    Pages are read by processes that this one forks, which share its pipe: that ends with the process that writes there.
    """
    if name.startswith(NOTEBOOKS) and _running:
        _running[0].stdout.read()  # type: ignore[union-attr]


def finish(app: Sphinx, error: Exception | None) -> None:
    """End the process that `start` began."""
    while _running:
        _running.pop().wait()


def run_notebooks(source: Path, folder: Path, timeout: int) -> None:
    """Run the notebooks of a source folder, and store their outputs in the cache of myst-nb."""
    shutil.rmtree(folder, ignore_errors=True)
    cache = get_cache(folder)
    for path in sorted((source / NOTEBOOKS).glob("*.ipynb"), key=lambda path: -path.stat().st_size):
        cache.add_nb_to_project(str(path))
    logger = logging.getLogger(__name__)
    logger.setLevel(logging.WARNING)
    load_executor("local-parallel", cache, logger).run_and_cache(timeout=timeout)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register; see `start`, `wait` and `finish`."""
    app.connect("builder-inited", start)
    app.connect("source-read", wait)
    app.connect("build-finished", finish)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    run_notebooks(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
