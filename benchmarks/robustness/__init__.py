"""What hostile inputs, kills, long runs, walls and repetitions do to the project."""

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
"""Folder of the checkout."""
Report = tuple[list[dict[str, Any]], list[str]]
"""What a stage found: the rows of its table, which have the same keys, and what failed."""


def call_elsewhere(function: Callable[..., Any], *arguments: Any, **variables: str) -> Any:
    """Return what a function returns in a new process, whose environment has some variables besides."""
    before = dict(os.environ)
    os.environ |= variables
    try:
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            return pool.submit(function, *arguments).result()
    finally:
        os.environ.clear()
        os.environ.update(before)
