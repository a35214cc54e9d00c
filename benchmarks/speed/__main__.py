"""Throughput of kernels, simulators, environments and training: `python -m lidarnaut.benchmarks.speed`.

Variants are measured in turn, on one core unless noted; values are medians. All environment designs explore two halls
with the same robot (360 beams, 10 m, 10 Hz), with TinySLAM or the true pose.
"""

import contextlib
import json
import os
import platform
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import tyro
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from lidarnaut.benchmarks.drives.recording import table
from lidarnaut.benchmarks.speed import measuring, parts
from lidarnaut.benchmarks.speed.designs import DESIGNS
from lidarnaut.benchmarks.speed.kernels import time_kernels
from lidarnaut.benchmarks.speed.peers.compare import PEERS, compare
from lidarnaut.envs.command_line import make_console, run_command
from lidarnaut.envs.files import read_mapping
from lidarnaut.envs.progress import Progress

Stage = Literal["designs", "kernels", "memory", "growth", "physics", "decisions", "people", "trainings", "peers"]
PLOT = Path(__file__).resolve().parents[2] / "docs" / "images" / "throughput.png"
BODIES = (50, 300)
"""Numbers of obstacles in the two benchmark halls."""
PACKAGES = ("numba", "numpy", "gymnasium", "stable-baselines3")

AXES = {
    "beams": "beams of a scan",
    "map_cells": "cells along each side of a map of 20 m",
    "num_envs": "sub-environments",
}
COLOURS = {"tinyslam": "#1668b8", "truth": "#d2600c"}


def main(
    only: tuple[Stage, ...] = get_args(Stage)[:-1],
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    quick: bool = False,
) -> None:
    """Run the throughput benchmarks, print a table for each, and plot the time of a step.

    Args:
        only: benchmarks to run; `peers` installs other simulators in `~/.cache/lidarnaut/peers`.
        json_file: also write the results to this file.
        quick: shorter measurements, without `growth`.
    """
    seconds, repeats = (0.1, 3) if quick else (0.4, 5)
    results: dict[str, Any] = {"machine": machine()}
    console = make_console()
    with contextlib.ExitStack() as stack:
        available = range(1, min(len(os.sched_getaffinity(0)), 2) + 1)
        calls = {cores: stack.enter_context(measuring.confined(cores)) for cores in available}
        one = calls[1]
        run: dict[str, Callable[[], list[dict[str, Any]]]] = {
            "designs": lambda: measuring.compare_designs(calls, DESIGNS, BODIES, seconds, repeats),
            "kernels": lambda: [row for bodies in BODIES for row in one(time_kernels, bodies, 3 * repeats)],
            "memory": lambda: one(measuring.memory, BODIES[0]),
            "growth": lambda: measuring.growth(calls, BODIES[0], seconds, repeats),
            "physics": lambda: one(parts.physics, 20 if quick else 200),
            "decisions": lambda: one(parts.decisions, 12 if quick else 120),
            "people": lambda: one(parts.people, 30 if quick else 600),
            "trainings": lambda: measuring.trainings(calls, 0.1 if quick else 10.0, 1 if quick else 3),
            "peers": lambda: compare(read_mapping(PEERS), 0.2 if quick else 1.5, 1 if quick else 3),
        }
        for stage in Progress([s for s in only if not (quick and s == "growth")], desc="speed", unit="stage"):
            results[stage] = run[stage]()
            console.print(table(side_by_side(results[stage]) if stage == "designs" else results[stage], stage))
    if json_file is not None:
        json_file.write_text(json.dumps(results, indent=1) + "\n")
    if "growth" in results:
        plot_growth(results["growth"], PLOT)


def side_by_side(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    lines: dict[tuple[Any, ...], dict[str, Any]] = {}
    for row in rows:
        design = {key: row[key] for key in ("name", "num_envs", "cores")}
        column = f"{row['bodies']}, {row['slam']}"
        lines.setdefault(tuple(design.values()), design)[column] = f"{row['steps_per_second']:,.0f}"
    return list(lines.values())


def plot_growth(rows: Sequence[dict[str, Any]], path: Path) -> None:
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    keys = list(dict.fromkeys(row["grows"] for row in rows))
    panels = figure.subplots(1, len(keys), sharey=True, squeeze=False)[0]
    for panel, key in zip(panels, keys, strict=True):
        points = [row for row in rows if row["grows"] == key]
        for slam, colour in COLOURS.items():
            line = [(point["at"], point["us"]) for point in points if point["slam"] == slam]
            panel.plot(*zip(*line, strict=True), marker="o", markersize=4, color=colour, label=slam)
        panel.set(xscale="log", yscale="log", xlabel=AXES[key])
        ticks = sorted({point["at"] for point in points})
        panel.set_xticks(ticks, [str(tick) for tick in ticks])
        panel.yaxis.set(major_locator=LogLocator(subs=(1, 2, 5)), major_formatter="{x:g}")
        panel.minorticks_off()
        panel.grid(alpha=0.3)
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("time for a step of one sub-environment [µs]")
    panels[0].legend(frameon=False, title="pose from")
    figure.suptitle("Time of a step of the vector environment on one core", x=0.01, ha="left", fontsize=11)
    figure.savefig(path, dpi=150, metadata={"Software": None})


def machine() -> dict[str, str]:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    cpu = f"{model or platform.processor() or platform.machine()}, {len(os.sched_getaffinity(0))} cores"
    return {"cpu": cpu, "python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


if __name__ == "__main__":
    run_command(main)
