"""A page about every world: `python -m envs.worlds.catalogue` prints the Markdown at the end of docs/worlds.md."""

import argparse
import math
import sys
from pathlib import Path
from typing import Any

from envs.files import read_record

from .library import LIBRARY, WORLD_NAMES, load_world
from .procedural import FAMILIES
from .raster import free_area, reachable
from .world import World
from .world_file import WorldFile

_RADIUS = 0.22
"""Radius of the robot for which the second free area is given [m]."""


def table() -> str:
    """Return the library as a Markdown table: size, free area, bodies, licence."""
    lines = [
        f"| world | size [m] | free area [m²] | for radius {_RADIUS} m [m²] | segments + circles | movers | licence |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in WORLD_NAMES:
        world = load_world(name)
        x_min, y_min, x_max, y_max = world.bounds
        areas = " | ".join(f"{free_area(world, radius=radius):.1f}" for radius in (0.0, _RADIUS))
        bodies = f"{len(world.segments)} + {len(world.circles)}"
        size = f"{x_max - x_min:.2f} x {y_max - y_min:.2f}"
        lines.append(f"| `{name}` | {size} | {areas} | {bodies} | {len(world.movers)} | {world.licence} |")
    return "\n".join(lines)


def descriptions() -> str:
    """Return where each world of the library comes from, and what was chosen or closed, as a Markdown list."""
    lines = []
    for name in WORLD_NAMES:
        file = read_record(LIBRARY[name], WorldFile)
        closed = sum(math.dist(row[:2], row[2:]) for row in file.closures)
        added = f" Closed by us: {closed:.1f} m of wall." if file.closures else ""
        notes = f" {file.notes}" if file.notes else ""
        lines.append(f"- `{name}`: {file.source}.{notes}{added}")
    return "\n".join(lines)


def draw(worlds: list[World], path: Path, columns: int = 6) -> None:
    """Save a picture of worlds side by side: what can be reached in white, spawns as red triangles."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    rows = -(-len(worlds) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(2.4 * columns, 2.6 * rows), layout="constrained", squeeze=False)
    for ax in axes.flat:
        ax.axis("off")
    for ax, world in zip(axes.flat, worlds):
        _draw_world(ax, world)
    figure.savefig(path, dpi=75)
    plt.close(figure)


def _draw_world(ax: Any, world: World) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Circle, Polygon

    grid, mask = reachable(world, resolution=max(0.02, 0.005 * max(world.bounds[2] - world.bounds[0], 1.0)))
    x_min, y_min, x_max, y_max = grid.bounds
    ax.imshow(mask, origin="lower", extent=(x_min, x_max, y_min, y_max), cmap="gray", vmin=-3, vmax=1)
    ax.add_collection(LineCollection(list(world.segments.reshape(-1, 2, 2)), colors="black", linewidths=0.6))
    for circle in world.circles:
        ax.add_patch(Circle(circle[:2], circle[2], color="black"))
    for mover in world.movers:
        ax.add_patch(Polygon(mover.waypoints, fill=False, edgecolor="tab:blue", linewidth=0.5))
        ax.add_patch(Circle(mover.position(0.0), mover.radius, color="tab:blue"))
    xs, ys, _ = zip(*world.spawns)
    ax.plot(xs, ys, "^", color="tab:red", markersize=3)
    ax.set_title(world.name, fontsize=7)


def main() -> None:
    """Print the catalogue, or save the picture of all worlds."""
    parser = argparse.ArgumentParser(description="Print facts about every world of the library as Markdown.")
    parser.add_argument("--picture", type=Path, help="save a picture of all worlds to this file instead")
    arguments = parser.parse_args()
    if arguments.picture:
        generated = [FAMILIES[family](seed, None) for family in FAMILIES for seed in (0, 1, 2)]
        draw([load_world(name) for name in WORLD_NAMES] + generated, arguments.picture)
    else:
        sys.stdout.write(f"{table()}\n\n{descriptions()}\n")


if __name__ == "__main__":
    main()
