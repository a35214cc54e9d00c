"""Damaged inputs, kills, long runs, walls, repetitions and large maps: `python -m benchmarks.robustness`."""

import sys
from typing import Annotated, Literal, get_args

import tyro

from envs.command_line import run_command
from envs.worlds import WORLD_NAMES

from .drives import drive_into_walls, slide_along_walls, take_steps
from .inputs import try_inputs
from .kills import kill_all
from .maps import reset_maps
from .repeats import repeat

Stage = Literal["inputs", "kills", "steps", "walls", "slides", "repeats", "maps"]
Kind = Literal["maps", "worlds", "robots", "configurations", "logs", "bags", "checkpoints"]


def main(
    stages: tuple[Stage, ...] = get_args(Stage),
    inputs: int = 10_000,
    kinds: tuple[Kind, ...] = get_args(Kind),
    kills: int = 40,
    steps: int = 1_000_000,
    worlds: Annotated[tuple[str, ...], tyro.conf.arg(help_behavior_hint="(default: the library)")] = WORLD_NAMES,
    physics: tuple[str, ...] = ("kinematic", "bullet"),
    wall_steps: int = 1000,
    map_size: int = 5000,
    seed: int = 0,
) -> int:
    """Try what must not make the programs fail, and print a table for each stage; see docs/robustness.md.

    Args:
        stages: what to try.
        inputs: damaged inputs, shared evenly by the kinds.
        kinds: of inputs.
        kills: of a training, and as many of an evaluation.
        steps: in a vector environment, with each SLAM.
        worlds: in which walls are driven into.
        physics: under which walls are driven into.
        wall_steps: control periods in each world under each physics.
        map_size: rows, and columns, of large maps of cells of 0.05 m.
        seed: of everything random.

    Returns:
        The exit status: 0 if nothing failed.
    """
    run = {
        "inputs": lambda: try_inputs(kinds, -(-inputs // len(kinds)), seed),
        "kills": lambda: kill_all(kills, seed),
        "steps": lambda: take_steps(steps, seed),
        "walls": lambda: drive_into_walls(worlds, physics, wall_steps, seed),
        "slides": lambda: slide_along_walls(physics),
        "repeats": lambda: repeat(seed),
        "maps": lambda: reset_maps(map_size),
    }
    status = 0
    for stage in stages:
        rows, failures = run[stage]()
        cells = [list(rows[0]), ["---"] * len(rows[0]), *(row.values() for row in rows)]
        for line in cells:
            print("| " + " | ".join(f"{cell:,}" if isinstance(cell, int) else str(cell) for cell in line) + " |")
        for failure in failures[:20]:
            print(f"failed: {failure}")
        print(f"and {len(failures) - 20} more" if len(failures) > 20 else "")
        status = max(status, int(bool(failures)))
    return status


if __name__ == "__main__":
    sys.exit(run_command(main))
