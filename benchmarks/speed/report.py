"""Readable results: the project's targets compared with what was measured, tables on the terminal, and a plot."""

import itertools
from pathlib import Path
from typing import NamedTuple

from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.speed.designs import Design
from benchmarks.speed.results import BODIES, FEW, MANY, SLAMS, Results

NAIVE, BULLET, KINEMATIC = Design("naive"), Design("bullet"), Design("kinematic")
VECTOR, TWO_CORES = Design("vector", MANY), Design("vector", MANY, 2)
BULLETS = Design("bullet_vector", FEW, 2)
TRAINING = Design("ppo", MANY, 2)
SPEEDS = (
    (f"vector, {MANY} sub-environments, one core, tinyslam [steps/s]", 10_000, "tinyslam", VECTOR),
    (f"vector, {MANY} sub-environments, one core, truth [steps/s]", 18_000, "truth", VECTOR),
    ("bullet, tinyslam [steps/s]", 4_000, "tinyslam", BULLET),
    ("bullet over naive, tinyslam", 10.0, "tinyslam", BULLET, NAIVE),
    ("vector on two cores over one, tinyslam", 1.8, "tinyslam", TWO_CORES, VECTOR),
    ("vector over kinematic, tinyslam", 0.9, "tinyslam", VECTOR, KINEMATIC),
    ("bullet vector on two cores over bullet, tinyslam", 1.7, "tinyslam", BULLETS, BULLET),
    ("ppo on two cores, tinyslam [steps/s]", 8_000, "tinyslam", TRAINING),
    ("ppo on two cores, truth [steps/s]", 12_000, "truth", TRAINING),
)
"""Name, least speed that is wanted, SLAM, and the design; with two designs, the least ratio of the first's speed."""
AXES = {
    "beams": "beams of a scan",
    "map_cells": "cells along each side of a map of 20 m",
    "num_envs": "sub-environments",
}
"""What the panels of the plot are about."""
COLOURS = {"tinyslam": "#1668b8", "truth": "#d2600c"}


class Target(NamedTuple):
    """A figure, and the least (or, where `at_most`, the greatest) that it should be."""

    name: str
    wanted: float
    measured: float
    at_most: bool = False

    @property
    def met(self) -> bool:
        """Whether it was reached."""
        return self.measured <= self.wanted if self.at_most else self.measured >= self.wanted


def targets(results: Results) -> list[Target]:
    """Return all targets whose designs were measured, the worse of the two halls each."""
    found = []
    for name, wanted, slam, *designs in SPEEDS:
        measured = []
        for bodies in BODIES:
            speeds = [results.speed(design, f"hall_{bodies}", slam) for design in designs]
            if None not in speeds:
                measured.append(speeds[0] / speeds[1] if len(speeds) > 1 else speeds[0])
        if measured:
            found.append(Target(name, wanted, min(measured)))
    memory = "state of a sub-environment, 400 x 400 cells [MiB]"
    return [*found, Target(memory, 1.0, results.state_bytes_per_env / 2**20, at_most=True)]


def print_results(results: Results, console: Console) -> None:
    """Print everything as tables."""
    columns = list(itertools.product((f"hall_{bodies}" for bodies in BODIES), SLAMS))
    speeds: dict[tuple[str, ...], dict[tuple[str, str], str]] = {}
    for row in results.rows:
        line = speeds.setdefault((row["design"], str(row["num_envs"]), str(row["cores"])), {})
        line[row["world"], row["slam"]] = f"{row['steps_per_second']:,.0f} {row['ratio_to_naive']:5.1f}"
    kernels = [
        (row["kernel"], f"{row['us']:.1f}", f"{row['us_reference']:,.0f}", f"{row['us_reference'] / row['us']:.0f}")
        for row in results.kernels
    ]
    wanted = [
        (
            t.name,
            f"at {'most' if t.at_most else 'least'} {t.wanted:,g}",
            f"{t.measured:,.4g}",
            "met" if t.met else "missed",
        )
        for t in targets(results)
    ]
    tables = {
        "Steps per second, all sub-environments together, and how often naive's": (
            ("design", "num_envs", "cores", *(f"{world}\n{slam}" for world, slam in columns)),
            [(*design, *(line.get(column, "") for column in columns)) for design, line in speeds.items()],
        ),
        "Microseconds per call, on one core": (("kernel", "compiled", "NumPy", "ratio"), kernels),
        "Targets, the worse of the halls each": (("target", "wanted", "measured", ""), wanted),
    }
    for title, (head, lines) in tables.items():
        table = Table(title=title, box=box.SIMPLE, padding=(0, 1, 0, 0))
        for k, heading in enumerate(head):
            table.add_column(heading, justify="right" if k else "left", no_wrap="\n" in heading)
        for line in lines:
            table.add_row(*line)
        console.print(table)
    console.print(f"A further sub-environment takes {results.state_bytes_per_env / 1024:,.0f} KiB.")
    if results.busy:
        console.print(
            "The machine was busy with other programs: these figures are too low, and ratios uncertain.", style="bold"
        )


def plot_growth(results: Results, path: Path) -> None:
    """Draw how the cost of a step grows, and write it as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.6), layout="constrained")
    panels = FigureCanvasAgg(figure).figure.subplots(1, len(results.growth), sharey=True, squeeze=False)[0]
    for panel, (key, points) in zip(panels, results.growth.items(), strict=True):
        for slam, colour in COLOURS.items():
            line = [(point["at"], point["us"]) for point in points if point["slam"] == slam]
            panel.plot(*zip(*line, strict=True), marker="o", markersize=4, color=colour, label=slam)
        ticks = sorted({point["at"] for point in points})
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_xticks(ticks, [str(tick) for tick in ticks])
        panel.minorticks_off()
        panel.set_xlabel(AXES[key])
        panel.grid(alpha=0.3)
        panel.spines[["top", "right"]].set_visible(False)
    times = [point["us"] for points in results.growth.values() for point in points]
    steps = [mantissa * 10.0**power for power in range(-1, 7) for mantissa in (1, 2, 5)]
    low, high = max(step for step in steps if step <= min(times)), min(step for step in steps if step >= max(times))
    panels[0].set_ylim(low, high)
    panels[0].set_yticks([step for step in steps if low <= step <= high])
    panels[0].yaxis.set_major_formatter("{x:g}")
    panels[0].set_ylabel("time for a step of one sub-environment [µs]")
    panels[0].legend(frameon=False, title="pose from")
    figure.suptitle("What a step of the vector environment costs on one core", x=0.01, ha="left", fontsize=11)
    figure.savefig(path, dpi=150, metadata={"Software": None})
