"""Measurement of steps per second and memory of environments, in processes pinned to CPU cores."""

import contextlib
import gc
import itertools
import os
import statistics
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from lidarnaut.agents.pools import make_pool
from lidarnaut.benchmarks.speed.designs import FEWEST_ENVS, TRAININGS, Case, Design, Drive, open_drive

SLAMS = ("tinyslam", "truth")
WARM_UP = 5000
GROWTH = {"beams": (90, 180, 360, 720, 1080), "map_cells": (200, 400, 800, 1600), "num_envs": (1, 4, 16, 64, 256, 1024)}
"""Problem sizes for measurements of the step time: lidar beams, map cells along 20 m, and sub-environments."""
STATE_ENVS = (4, 12)
Call = Callable[..., Any]

_drives: dict[Case, Drive] = {}


@contextlib.contextmanager
def confined(num_cores: int) -> Iterator[Call]:
    """Yield a function that runs other functions in a process pinned to the last `num_cores` CPU cores."""
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with make_pool(1, None) as pool:
        pool.submit(os.sched_setaffinity, 0, sorted(os.sched_getaffinity(0))[-num_cores:]).result()
        yield lambda function, *arguments: pool.submit(function, *arguments).result()
        pool.submit(open_cases, []).result()


def open_cases(cases: list[Case]) -> None:
    for drive in _drives.values():
        drive.close()
    _drives.clear()
    gc.unfreeze()
    for case in cases:
        _drives[case] = open_drive(case)
        _drives[case].step(min(max(WARM_UP // case.design.num_envs, 20), 100))
    # Exclude live objects from later garbage collections.
    gc.collect()
    gc.freeze()


def steps_per_second(case: Case, seconds: float) -> float:
    """Return the steps per wall-clock second over all sub-environments, measured for about `seconds`."""
    drive, count, start = _drives[case], 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds or not count:
        drive.step(drive.at_once)
        count += drive.at_once
    return count * case.design.num_envs / elapsed


def compare(calls: dict[int, Call], cases: Sequence[Case], seconds: float, repeats: int) -> dict[Case, float]:
    """Return median steps per second of environment designs, measured in turn so that other load affects all equally.

    `calls`: by number of CPU cores, a function that runs another in a process pinned to this number of cores.
    """
    turns = [case for case in cases if case.design.cores in calls]
    for cores, call in calls.items():
        call(open_cases, [case for case in turns if case.design.cores == cores])
    speeds: dict[Case, list[float]] = {case: [] for case in turns}
    for case in turns * repeats:
        speeds[case].append(calls[case.design.cores](steps_per_second, case, seconds))
    return {case: statistics.median(values) for case, values in speeds.items()}


def compare_designs(
    calls: dict[int, Call], designs: tuple[Design, ...], bodies: tuple[int, ...], seconds: float, repeats: int
) -> list[dict[str, Any]]:
    rows = []
    for num_bodies, slam in itertools.product(bodies, SLAMS):
        speeds = compare(calls, [Case(design, num_bodies, slam) for design in designs], seconds, repeats)
        for case, speed in speeds.items():
            rows.append({**case.design._asdict(), "bodies": num_bodies, "slam": slam, "steps_per_second": speed})
    return rows


def trainings(calls: dict[int, Call], seconds: float, repeats: int) -> list[dict[str, Any]]:
    """Return the steps per second of whole trainings, rollouts and updates, on one core and on two."""
    cases = [Case(Design(name, cores=cores), 0, "") for name in TRAININGS for cores in calls]
    speeds = compare(calls, cases, seconds, repeats)
    return [{"training": at.design.name, "cores": at.design.cores, "steps/s": speed} for at, speed in speeds.items()]


def growth(calls: dict[int, Call], num_bodies: int, seconds: float, repeats: int) -> list[dict[str, Any]]:
    """Return the step time of a sub-environment [us] for growing numbers of beams, map cells and sub-environments."""
    rows = []
    for (key, values), slam in itertools.product(GROWTH.items(), SLAMS):
        cases = {}
        for at in values:
            size = {"beams": 360, "map_cells": 400, "num_envs": FEWEST_ENVS} | {key: at}
            design = Design("vector", size["num_envs"])
            cases[Case(design, num_bodies, slam, size["beams"], 20.0 / size["map_cells"])] = at
        speeds = compare(calls, list(cases), seconds, repeats)
        rows += [{"grows": key, "slam": slam, "at": cases[case], "us": 1e6 / speed} for case, speed in speeds.items()]
    return rows


def memory(num_bodies: int) -> list[dict[str, Any]]:
    """Return the memory per additional sub-environment [MiB], with a map of 400 x 400 cells."""
    open_drive(Case(Design("vector"), num_bodies, "tinyslam")).close()  # allocates shared memory
    sizes = []
    for num_envs in STATE_ENVS:
        gc.collect()
        tracemalloc.start()
        drive = open_drive(Case(Design("vector", num_envs), num_bodies, "tinyslam"))
        drive.step(1)
        gc.collect()
        sizes.append(tracemalloc.get_traced_memory()[0])
        drive.close()
        tracemalloc.stop()
    return [{"MiB of a further sub-environment": (sizes[1] - sizes[0]) / (STATE_ENVS[1] - STATE_ENVS[0]) / 2**20}]
