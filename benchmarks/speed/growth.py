"""The picture of how the cost of a step grows."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

AXES = {
    "beams": "beams of a scan",
    "map_cells": "cells along each side of a map of 20 m",
    "num_envs": "sub-environments",
}
"""What the panels are about."""
COLOURS = {"tinyslam": "#1668b8", "truth": "#d2600c"}


def plot_growth(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw rows of `grows` (of `AXES`), `slam`, `at` and `us`, and write the picture as PNG."""
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
    figure.suptitle("What a step of the vector environment costs on one core", x=0.01, ha="left", fontsize=11)
    figure.savefig(path, dpi=150, metadata={"Software": None})
