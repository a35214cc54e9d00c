"""A page about every world: `python -m envs.worlds.catalogue` prints the Markdown at the end of docs/worlds.md."""

import math
import sys

from envs.files import read_record

from .library import LIBRARY, WORLD_NAMES, load_world
from .raster import free_area
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


def main() -> None:
    """Print the catalogue."""
    sys.stdout.write(f"{table()}\n\n{descriptions()}\n")


if __name__ == "__main__":
    main()
