import os
import signal
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec

import pytest

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("OMP_NUM_THREADS", "1")  # trainings in one process, with the same weights everywhere
# Background jobs of a script inherit an ignored SIGINT, and pass it to the processes that tests interrupt.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# `make test-python` installs no torch.
package = [f"package/{name}.py" for name in ("test_every_id", "test_wheel")]
learning = ["agents", "benchmarks", "examples", "robustness", *package]
collect_ignore = [] if find_spec("torch") else learning


def pytest_addoption(parser):
    parser.addoption("--slow", action="store_true", help="run what is marked `slow`, and tests/robustness at full size")


def pytest_collection_modifyitems(config, items):
    if not config.getoption("slow"):
        slow = [item for item in items if "slow" in item.keywords]
        config.hook.pytest_deselected(items=slow)
        items[:] = [item for item in items if item not in slow]


def pytest_terminal_summary(terminalreporter):
    tables = defaultdict(list)
    for report in terminalreporter.getreports("passed") + terminalreporter.getreports("failed"):
        for name, value in report.user_properties:
            if name == "row":
                tables[value[0]].append(value[1])
    for title, rows in tables.items():
        terminalreporter.section(title, sep="-")
        for line in (rows[0], ["---"] * len(rows[0]), *(row.values() for row in rows)):
            cells = (
                f"{cell:,.4g}" if isinstance(cell, float) else f"{cell:,}" if isinstance(cell, int) else cell
                for cell in line
            )
            terminalreporter.write_line(f"| {' | '.join(cells)} |")


@pytest.fixture
def no_curves(monkeypatch):
    """Replace plots of learning curves, which are slow, by a header."""
    monkeypatch.setattr(
        "lidarnaut.agents.run_folder.draw_learning_curve", lambda rows, title, path, *_: path.write_bytes(b"\x89PNG")
    )


@pytest.fixture
def no_workers(monkeypatch):
    """Run evolutions in this process: workers take seconds to start."""
    monkeypatch.setattr("lidarnaut.agents.frontiers.evolution.make_pool", lambda *_: ThreadPoolExecutor(1))


@pytest.fixture
def no_overview(monkeypatch):
    """Skip the slow pictures over all worlds."""
    for name in ("curves_section", "gallery_section"):
        monkeypatch.setattr(f"lidarnaut.benchmarks.arena.overview.{name}", lambda *_: None)
