"""Steps per second of environments and trainings: `python -m lidarnaut.benchmarks.speed`.

Cases are measured in turn, pinned to CPU cores; values are medians of wall-clock rates.
"""

import gc
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from statistics import median
from typing import Any, Literal, get_args

from lidarnaut.benchmarks.drives.recording import table
from lidarnaut.benchmarks.speed import cases
from lidarnaut.benchmarks.speed.cases import Case
from lidarnaut.benchmarks.speed.peers import compare as peers
from lidarnaut.envs.command_line import make_console, run_command
from lidarnaut.envs.files import read_mapping
from lidarnaut.envs.progress import Progress

Stage = Literal["designs", "decisions", "people", "trainings", "libraries", "peers"]
SECONDS = {"designs": 0.5, "decisions": 3.0, "people": 1.0, "trainings": 10.0, "libraries": 10.0, "peers": 1.5}
"""Duration of a measurement [s]."""
REPEATS = 3
"""Number of measurements of each case."""


def main(only: tuple[Stage, ...] = get_args(Stage)[:-2]) -> None:
    """Measure steps per second, and print a table for each benchmark.

    Args:
        only: benchmarks to run; `libraries` takes over 15 minutes, `peers` installs other simulators in
            `~/.cache/lidarnaut/peers`.
    """
    for stage in Progress(only, desc="speed", unit="benchmark"):
        if stage == "peers":
            rows = peers.compare(read_mapping(peers.PEERS), SECONDS[stage], REPEATS)
        else:
            rows = compare(getattr(cases, stage)(), SECONDS[stage])
        make_console().print(table(rows, stage))


def compare(groups: Iterable[Sequence[Case]], seconds: float) -> list[dict[str, Any]]:
    """Return a table of the median steps per second of all sub-environments; cases of a group are measured in turn."""
    rows: dict[str, dict[str, Any]] = {}
    available = sorted(os.sched_getaffinity(0))
    for group in groups:
        opened = {case: case.drive() for case in group if case.cores <= len(available)}
        speeds: dict[Case, list[float]] = {case: [] for case in opened}
        try:
            for case in [*opened] * (REPEATS + 1):
                os.sched_setaffinity(0, available[-case.cores :])
                speeds[case].append(steps_per_second(opened[case], seconds))
                gc.freeze()  # garbage collection skips the environments
        finally:
            os.sched_setaffinity(0, available)
            for drive in opened.values():
                drive.close()
            gc.unfreeze()
        for case, (_, *found) in speeds.items():  # the first is the warm-up
            rows.setdefault(case.row, {"": case.row})[case.column] = f"{median(found):,.0f}"
    return list(rows.values())


def steps_per_second(drive: Iterator[int], seconds: float) -> float:
    next(drive)  # opens it, or refills the caches
    count, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds or not count:
        count += next(drive)
    return count / elapsed


if __name__ == "__main__":
    run_command(main)
