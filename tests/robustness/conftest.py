"""Sizes and result tables of robustness tests; `pytest tests/robustness --slow` runs many more cases."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor

import pytest


@pytest.fixture
def row(record_property):
    """Return a function that adds a row, by keyword, to a table that is printed after all tests."""
    return lambda table, **cells: record_property("row", (table, {k.replace("_", " "): v for k, v in cells.items()}))


@pytest.fixture
def size(request):
    return lambda few, many: many if request.config.getoption("slow") else few


def in_new_process(function, *arguments, **variables):
    before = dict(os.environ)
    os.environ |= variables
    try:
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            return pool.submit(function, *arguments).result()
    finally:
        os.environ.clear()
        os.environ.update(before)
