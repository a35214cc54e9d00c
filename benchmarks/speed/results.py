"""Results of a run of the benchmark, and how it measures."""

import itertools
import os
import platform
import statistics
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.speed.designs import SUBPROCESSES, Case, Design
from benchmarks.speed.worker import Worker

BODIES = (50, 300)
"""Crates and pillars in the halls that are driven in."""
SLAMS = ("tinyslam", "truth")
FEW, MANY = 16, 256
"""Sub-environments of the vector environments that are measured on one core and on two."""
DESIGNS = (
    Design("naive"),
    Design("bullet"),
    Design("kinematic"),
    *(Design("vector", num_envs) for num_envs in (FEW, 64, MANY)),
    *(Design("vector", num_envs, cores=2) for num_envs in (FEW, 64, MANY)),
    Design("bullet_vector", FEW),
    Design("bullet_vector", FEW, cores=2),
    Design("subproc", SUBPROCESSES),
    Design("subproc", SUBPROCESSES, cores=2),
    Design("ppo", MANY, cores=2),
)
"""What is measured side by side."""
GROWTH = {"beams": (90, 180, 360, 720, 1080), "map_cells": (200, 400, 800, 1600), "num_envs": (1, 4, 16, 64, 256, 1024)}
"""What cost is measured to grow with: beams of a scan, cells along a side of a map of 20 m, sub-environments."""
MAP_SIDE = 20.0
"""Side of a new map [m]."""
BUSY = 0.9
"""Share of its core below which a measuring process has evidently been disturbed."""


class Effort(NamedTuple):
    """How much time is spent."""

    seconds: float
    """Length of one measurement [s]."""
    repeats: int
    """Measurements of which the median is taken."""
    designs: tuple[Design, ...] = DESIGNS
    growth: bool = True
    bodies: tuple[int, ...] = BODIES
    slams: tuple[str, ...] = SLAMS


FULL = Effort(seconds=0.4, repeats=5)
QUICK = Effort(seconds=0.1, repeats=3, designs=DESIGNS, growth=False)


@dataclass(slots=True)
class Results:
    """Everything measured, as it is written to JSON."""

    machine: dict[str, str] = field(default_factory=dict)
    busy: bool = False
    """Whether other programs took the cores at the same time, so that figures are too low and ratios uncertain."""
    rows: list[dict[str, Any]] = field(default_factory=list)
    """`design`, `world`, `slam`, `num_envs`, `cores`, `steps_per_second`, `ratio_to_naive`."""
    kernels: list[dict[str, Any]] = field(default_factory=list)
    """`kernel`, `us`, `us_reference`."""
    state_bytes_per_env: int = 0
    """Memory that a further sub-environment takes, with a map of 400 x 400 cells [bytes]."""
    growth: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    """For each key of `GROWTH` points of `slam`, `at` and `us`, the time for a step of a sub-environment [us]."""

    def speed(self, design: Design, world: str, slam: str) -> float | None:
        """Return the steps per second of a design, None if it was not measured."""
        wanted = dict(zip(("design", "num_envs", "cores"), design)) | {"world": world, "slam": slam}
        return next((row["steps_per_second"] for row in self.rows if wanted.items() <= row.items()), None)


def run(effort: Effort, note: Callable[[str], object]) -> Results:
    """Measure everything; `note` is called with what comes next."""
    available = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    designs = [design for design in effort.designs if design.cores <= len(available)]
    results = Results(machine=_machine(len(available)))
    workers: dict[int, Worker] = {}
    try:
        for count in sorted({design.cores for design in designs}):
            workers[count] = Worker(list(available[-count:]))
        shares: list[float] = []
        for num_bodies, slam in itertools.product(effort.bodies, effort.slams):
            note(f"{len(designs)} designs in a hall of {num_bodies} bodies, {slam}")
            cases = [Case(design, num_bodies, slam) for design in designs]
            results.rows += _rows(_measure(workers, cases, effort, shares))
        for num_bodies in effort.bodies:
            note(f"kernels in a hall of {num_bodies} bodies")
            results.kernels += workers[1].call("measure_kernels", num_bodies, 0.1 * effort.seconds, 5)
        note("memory")
        results.state_bytes_per_env = workers[1].call("measure_state", effort.bodies[0], "tinyslam")
        for key, slam in itertools.product(GROWTH if effort.growth else (), SLAMS):
            note(f"how cost grows with {key.replace('_', ' ')}, {slam}")
            points = {at: _grown(key, at, slam) for at in GROWTH[key]}
            speeds = _measure(workers, list(points.values()), effort, shares)
            lines = [{"slam": slam, "at": at, "us": 1e6 / speeds[case]} for at, case in points.items()]
            results.growth.setdefault(key, []).extend(lines)
        results.busy = statistics.median(shares) < BUSY
    finally:
        for worker in workers.values():
            worker.close()
    return results


def _measure(workers: dict[int, Worker], cases: list[Case], effort: Effort, shares: list[float]) -> dict[Case, float]:
    """Measure cases in turn, such that whatever else the machine does meets all alike.

    Returns:
        The median steps per second of each; the shares of the cores that were had are appended to `shares`.
    """
    for count, worker in workers.items():
        worker.call("open", [case for case in cases if case.design.cores == count])
    speeds: dict[Case, list[float]] = {case: [] for case in cases}
    for _ in range(effort.repeats):
        for case in cases:
            sample = workers[case.design.cores].call("measure", case, effort.seconds)
            speeds[case].append(sample.steps_per_second)
            if case.design.cores == 1 and case.design.name != "subproc":
                shares.append(sample.share)
    for worker in workers.values():
        worker.call("close")
    return {case: statistics.median(values) for case, values in speeds.items()}


def _rows(speeds: dict[Case, float]) -> list[dict[str, Any]]:
    """Return the rows of cases that share hall and SLAM, `naive` among them."""
    naive = next(speed for case, speed in speeds.items() if case.design.name == "naive")
    rows = []
    for case, speed in speeds.items():
        name, num_envs, cores = case.design
        row = {"design": name, "world": f"hall_{case.num_bodies}", "slam": case.slam, "num_envs": num_envs}
        rows.append(row | {"cores": cores, "steps_per_second": speed, "ratio_to_naive": speed / naive})
    return rows


def _grown(key: str, at: int, slam: str) -> Case:
    """Return the case in which what `key` of `GROWTH` names has grown to `at`."""
    beams = at if key == "beams" else 360
    cells = at if key == "map_cells" else 400
    return Case(Design("vector", at if key == "num_envs" else FEW), BODIES[0], slam, beams, MAP_SIDE / cells)


def _machine(num_cores: int) -> dict[str, str]:
    """Say what the figures were measured on."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    packages = {name: version(name) for name in ("numba", "numpy", "gymnasium", "stable-baselines3")}
    cpu = f"{model or platform.processor() or platform.machine()}, {num_cores} cores"
    return {"cpu": cpu, "python": platform.python_version(), **packages}
