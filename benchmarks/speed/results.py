"""What a run of the benchmark finds out, and how it goes about it."""

import itertools
import os
import platform
import statistics
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.speed.designs import SUBPROCESSES, Design
from benchmarks.speed.worker import Worker

BODIES = (50, 300)
"""Crates and pillars in the halls that are driven in."""
SLAMS = ("tinyslam", "truth")
"""Who tells where the robot is."""
PAIRED_LANES = 256
"""Lanes of the vector environment that is measured on one core and on two."""
DESIGNS = (
    Design("naive"),
    Design("bullet"),
    Design("kinematic"),
    *(Design("vector", lanes) for lanes in (1, 16, PAIRED_LANES, 1024)),
    Design("vector", PAIRED_LANES, cores=2),
    Design("subproc", SUBPROCESSES),
    Design("subproc", SUBPROCESSES, cores=2),
)
"""What is measured side by side."""
GROWTH = {"beams": (90, 180, 360, 720, 1080), "map_cells": (200, 400, 800, 1600), "lanes": (1, 4, 16, 64, 256, 1024)}
"""Along what the growth of cost is measured: beams of a scan, cells along each side of a map of 20 m, lanes."""
GROWTH_LANES = 16
"""Lanes while beams or cells grow."""
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
    """What to measure."""
    growth: bool = True
    """Whether to measure how cost grows."""
    bodies: tuple[int, ...] = BODIES
    """Halls to drive in."""
    slams: tuple[str, ...] = SLAMS
    """Who tells where the robot is."""


FULL = Effort(seconds=0.4, repeats=5)
QUICK = Effort(seconds=0.1, repeats=3, designs=tuple(d for d in DESIGNS if d.lanes < 1024), growth=False)


@dataclass(slots=True)
class Results:
    """Everything measured, as it is written to JSON."""

    machine: dict[str, str] = field(default_factory=dict)
    """On what, and with which versions."""
    busy: bool = False
    """Whether other programs took the cores at the same time, so that figures are too low and ratios uncertain."""
    rows: list[dict[str, Any]] = field(default_factory=list)
    """`design`, `world`, `slam`, `lanes`, `cores`, `steps_per_second`, `ratio_to_naive`."""
    kernels: list[dict[str, Any]] = field(default_factory=list)
    """`kernel`, `us`, `us_reference`."""
    state_bytes_per_lane: int = 0
    """Memory that a further lane of the vector environment takes, with a map of 400 x 400 cells [bytes]."""
    growth: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    """For each key of `GROWTH` points of `slam`, `at` and `us`, the time for a step of a lane [us]."""

    def speed(self, design: Design, world: str, slam: str) -> float | None:
        """Return the steps per second of a design, None if it was not measured."""
        wanted = (*design, world, slam)
        keys = ("design", "lanes", "cores", "world", "slam")
        found = (row["steps_per_second"] for row in self.rows if tuple(row[key] for key in keys) == wanted)
        return next(found, None)


def run(effort: Effort, note: Callable[[str], object]) -> Results:
    """Measure everything; `note` is told what comes next."""
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
            results.rows += _rows(workers, designs, num_bodies, slam, effort, shares)
        results.busy = statistics.median(shares) < BUSY
        for num_bodies in effort.bodies:
            note(f"kernels in a hall of {num_bodies} bodies")
            for name, us, reference in workers[1].call("measure_kernels", num_bodies, 0.1 * effort.seconds, 5):
                results.kernels.append({"kernel": f"{name} (hall_{num_bodies})", "us": us, "us_reference": reference})
        note("memory")
        results.state_bytes_per_lane = workers[1].call("measure_state", effort.bodies[0], "tinyslam")
        if effort.growth:
            for key, slam, at, speed in _growth(workers[1], effort, note):
                results.growth.setdefault(key, []).append({"slam": slam, "at": at, "us": 1e6 / speed})
    finally:
        for worker in workers.values():
            worker.close()
    return results


def _rows(
    workers: dict[int, Worker], designs: list[Design], num_bodies: int, slam: str, effort: Effort, shares: list[float]
) -> list[dict[str, Any]]:
    """Measure designs in turn, such that whatever else the machine does meets all alike."""
    for count, worker in workers.items():
        worker.call("open", [design for design in designs if design.cores == count], num_bodies, slam)
    speeds: dict[Design, list[float]] = {design: [] for design in designs}
    for _ in range(effort.repeats):
        for design in designs:
            sample = workers[design.cores].call("measure", design, effort.seconds)
            speeds[design].append(sample.steps_per_second)
            if design.name in ("naive", "bullet", "kinematic"):
                shares.append(sample.share)
    for worker in workers.values():
        worker.call("close")
    medians = {design: statistics.median(values) for design, values in speeds.items()}
    return [
        {
            "design": design.name,
            "world": f"hall_{num_bodies}",
            "slam": slam,
            "lanes": design.lanes,
            "cores": design.cores,
            "steps_per_second": speed,
            "ratio_to_naive": speed / medians[Design("naive")],
        }
        for design, speed in medians.items()
    ]


def _growth(worker: Worker, effort: Effort, note: Callable[[str], object]) -> Iterator[tuple[str, str, int, float]]:
    """Yield along what cost grows, the SLAM, how far it is, and steps per second."""
    for key, values in GROWTH.items():
        note(f"how cost grows with {key.replace('_', ' ')}")
        for slam, at in itertools.product(SLAMS, values):
            design = Design("vector", at if key == "lanes" else GROWTH_LANES)
            beams = at if key == "beams" else 360
            resolution = MAP_SIDE / (at if key == "map_cells" else 400)
            arguments = (design, BODIES[0], slam, beams, resolution, 0.5 * effort.seconds, 3)
            yield key, slam, at, worker.call("measure_alone", *arguments)


def _machine(num_cores: int) -> dict[str, str]:
    """Say what the figures were measured on."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    packages = {name: version(name) for name in ("numba", "numpy", "gymnasium", "stable-baselines3")}
    cpu = f"{model or platform.processor() or platform.machine()}, {num_cores} cores"
    return {"cpu": cpu, "python": platform.python_version(), **packages}
