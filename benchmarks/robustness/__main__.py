"""Damaged inputs, kills, long runs, walls, repetitions and large maps: `python -m benchmarks.robustness`."""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro

from envs.command_line import run_command
from envs.progress import Progress
from envs.robots import ROBOT_NAMES
from envs.worlds import WORLD_NAMES

from .inputs import try_inputs
from .kills import kill_evaluation, kill_training
from .maps import CASES as RESETS
from .maps import MAPS, MOST_MEMORY, MOST_TIME, measure
from .repeats import CASES, WAYS, digest, digest_elsewhere
from .steps import take_steps
from .walls import drive, slide

Stage = Literal["inputs", "kills", "steps", "walls", "repeats", "maps"]
Kind = Literal["maps", "worlds", "robots", "configurations", "logs", "bags", "checkpoints"]
SLAMS = ("tinyslam", "hector")
"""Of the vector environment that takes many steps."""
ANGLES = (15, 30, 45, 60, 75)
"""Between a robot's heading and the wall that it drives into [deg]."""
GROWTH = 1.05
"""Memory at the end over that in the middle of a run up to which it counts as flat."""


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
        "inputs": lambda: _inputs(kinds, -(-inputs // len(kinds)), seed),
        "kills": lambda: _kills(kills, seed),
        "steps": lambda: _steps(steps, seed),
        "walls": lambda: _walls(worlds, physics, wall_steps, seed),
        "repeats": lambda: _repeats(seed),
        "maps": lambda: _maps(map_size),
    }
    return max([run[stage]() for stage in stages], default=0)


def _inputs(kinds: tuple[str, ...], count: int, seed: int) -> int:
    results = try_inputs(kinds, count, seed)
    rows = [(c.kind, count, c.refused, c.accepted, len(c.failures)) for c in results]
    _print_table(("damaged", "tried", "refused with a clear error", "accepted", "failed"), rows)
    failures = [f"{c.kind}, {failure}" for c in results for failure in c.failures]
    return _tell(failures)


def _kills(count: int, seed: int) -> int:
    results = []
    for kill in (kill_training, kill_evaluation):
        with tempfile.TemporaryDirectory() as folder:
            results.append(kill(count, seed, Path(folder)))
    rows = [(r.what, r.kills, r.ends, len(r.lost)) for r in results]
    _print_table(("kill -9 of", "kills", "runs that ended and were compared", "lost"), rows)
    return _tell([f"{result.what}: {lost}" for result in results for lost in result.lost])


def _steps(count: int, seed: int) -> int:
    results = [take_steps(slam, count, seed) for slam in SLAMS]
    head = ("SLAM", "steps", "episodes", "memory in the second quarter [MiB]", "in the last quarter [MiB]")
    _print_table(head, [(r.slam, r.steps, r.episodes, f"{r.middle:.0f}", f"{r.end:.0f}") for r in results])
    return _tell([f"memory grows with {r.slam}" for r in results if r.end > GROWTH * r.middle])


def _walls(worlds: tuple[str, ...], physics: tuple[str, ...], steps: int, seed: int) -> int:
    pairs = [(world, one) for one in physics for world in worlds]
    drives = [drive(*pair, steps, seed) for pair in Progress(pairs, desc="walls", unit="drive")]
    rows = []
    for one in physics:
        own = [d for d in drives if d.physics == one]
        sums = [sum(getattr(d, name) for d in own) for name in ("steps", "contacts", "through", "too_fast")]
        rows.append((one, len(own), *sums))
    _print_table(("physics", "worlds", "control periods", "in contact", "through a wall", "above the speed"), rows)
    slides = []
    for robot in ROBOT_NAMES:
        slides.append((robot, *(" / ".join(f"{slide(robot, one, angle):.2f}" for one in physics) for angle in ANGLES)))
    _print_table((f"along a wall [m]: {' / '.join(physics)}", *(f"{angle} deg" for angle in ANGLES)), slides)
    return _tell([str(d) for d in drives if d.through or d.too_fast])


def _repeats(seed: int, steps: int = 100) -> int:
    cases = list(CASES)
    wanted = [digest(case, seed, steps) for case in Progress(cases, desc="episodes", unit="episode")]
    rows, failures = [], []
    for way in Progress(WAYS, desc="repeats", unit="process"):
        found = digest_elsewhere(cases, way, seed, steps)
        different = [case for case, a, b in zip(cases, wanted, found, strict=True) if a != b]
        rows.append((way, len(cases), len(different)))
        failures += [f"{case} differs {way}" for case in different]
    _print_table(("the same seed", "episodes", "other bytes"), rows)
    return _tell(failures)


def _maps(size: int) -> int:
    results = measure(list(MAPS), size)
    rows = []
    for name in MAPS:
        own = [r for r in results if r.name == name]
        times = [f"{r.time:.1f}" + (" (refused)" if r.refused else "") for r in own]
        rows.append((name, max(r.walls for r in own), *times, f"{max(r.memory for r in own):.1f}"))
    _print_table(("map", "walls", *(f"{case} [s]" for case in RESETS), "memory [GiB]"), rows)
    return _tell([str(r) for r in results if r.time > MOST_TIME or r.memory > MOST_MEMORY])


def _print_table(head: tuple[str, ...], rows: Sequence[tuple[object, ...]]) -> None:
    """Print a table of Markdown."""
    lines = [head, tuple("---" for _ in head), *rows]
    cells = [[f"{cell:,}" if isinstance(cell, int) else str(cell) for cell in line] for line in lines]
    print("\n" + "\n".join(f"| {' | '.join(line)} |" for line in cells))


def _tell(failures: list[str]) -> int:
    """Print what failed, the first ones of many, and return the exit status."""
    for failure in failures[:20]:
        print(f"failed: {failure}")
    if len(failures) > 20:
        print(f"and {len(failures) - 20} more")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(run_command(main))
