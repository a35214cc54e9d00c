"""Runs the notebooks side by side before the pages are read; myst-nb alone runs one after the other."""

import logging
import shutil
from pathlib import Path
from typing import Any

from jupyter_cache import get_cache
from jupyter_cache.executors import load_executor
from sphinx.application import Sphinx


def run_notebooks(app: Sphinx) -> None:
    """Run all notebooks of `docs/tutorials` anew, and keep what they give where myst-nb looks for it.

    One that fails is run again by myst-nb, which then says why.
    """
    folder = Path(app.config.nb_execution_cache_path)
    shutil.rmtree(folder, ignore_errors=True)
    cache = get_cache(folder)
    notebooks = sorted((Path(app.srcdir) / "tutorials").glob("*.ipynb"), key=lambda path: -path.stat().st_size)
    for path in notebooks:
        cache.add_nb_to_project(str(path))
    logger = logging.getLogger(__name__)
    logger.setLevel(logging.WARNING)
    load_executor("local-parallel", cache, logger).run_and_cache(timeout=app.config.nb_execution_timeout)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register; see `run_notebooks`."""
    app.connect("builder-inited", run_notebooks)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
