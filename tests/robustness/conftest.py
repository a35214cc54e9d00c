"""Sizes and tables of what must not make the programs fail: `pytest tests/robustness --slow` tries far more of it."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor

import pytest


@pytest.fixture
def row(record_property):
    """Return a function that adds a row, by keyword, to a table that is printed when all tests have run."""
    return lambda table, **cells: record_property("row", (table, {k.replace("_", " "): v for k, v in cells.items()}))


@pytest.fixture
def size(request):
    """Return a function that chooses one of two sizes: of every run of the tests, and with `--slow`."""
    return lambda few, many: many if request.config.getoption("slow") else few


def in_new_process(function, *arguments, **variables):
    """Return what a function returns in a new process, whose environment has some variables besides."""
    before = dict(os.environ)
    os.environ |= variables
    try:
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            return pool.submit(function, *arguments).result()
    finally:
        os.environ.clear()
        os.environ.update(before)
