"""How many decisions per second `lidarnaut/ExploreFrontiers-v0` takes: `python -m benchmarks.decisions_throughput`.

Rooms of 20 m x 20 m, TurtleBot3 Burger (360 beams of 3.5 m), TinySLAM, kinematic physics, always the nearest frontier.
Each design explores for as many decisions in each of its environments, so that maps small and large are in all figures;
they take turns in short slices, all in one process pinned to one core. What counts is processor time: the wall clock of
a shared machine also measures other processes. Worlds that are drawn ahead in the background count as well.
"""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import tyro
from gymnasium.vector import AutoresetMode
from rich.console import Console
from rich.table import Table

from envs.explore_frontiers import ExploreFrontiersEnv
from envs.vector import ExploreFrontiersVectorEnv

WORLD = {"world": "rooms", "world_size": (20.0, 20.0), "physics": "kinematic"}
WARM_UP = 3
"""Decisions before the clock starts: they compile, and draw the first worlds."""


@dataclass
class Tally:
    """What a design has done."""

    decisions: int = 0
    """Decisions of all sub-environments."""
    steps: int = 0
    """Control steps in them."""
    simulated: float = 0.0
    """Simulated time [s]."""
    seconds: float = 0.0
    """Processor time [s]."""
    slices: tuple[float, ...] = ()
    """Decisions per second of each slice."""


def single() -> Callable[[], tuple[int, int, float]]:
    """Return what takes a decision in a single environment, and returns decisions, control steps and simulated time."""
    env = ExploreFrontiersEnv(**WORLD)
    env.reset(seed=0)

    def decide() -> tuple[int, int, float]:
        *_, terminated, truncated, info = env.step(np.int64(0))
        if terminated or truncated:
            env.reset()
        return 1, info["decision_steps"], info["decision_time"]

    return decide


def vector(count: int) -> Callable[[], tuple[int, int, float]]:
    """Return the same for a number of sub-environments."""
    env = ExploreFrontiersVectorEnv(count, num_workers=0, autoreset_mode=AutoresetMode.NEXT_STEP, **WORLD)
    env.reset(seed=0)
    nearest = np.zeros(count, dtype=np.int64)

    def decide() -> tuple[int, int, float]:
        *_, info = env.step(nearest)
        taken = info["outcome"] != "reset"
        return np.count_nonzero(taken), info["decision_steps"].sum(), info["decision_time"].sum()

    return decide


def main(decisions: int = 600, slices: int = 20, sizes: tuple[int, ...] = (16, 64, 256)) -> None:
    """Measure and print a table.

    Args:
        decisions: of each environment; 600 take them through about two thirds of an episode.
        slices: into how many turns these are divided.
        sizes: numbers of sub-environments that are compared with the single environment.
    """
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    designs = {"single": single(), **{f"{count} sub-environments": vector(count) for count in sizes}}
    tallies = {name: Tally() for name in designs}
    for decide in designs.values():
        for _ in range(WARM_UP):
            decide()
    for turn in range(slices):
        for name, decide in designs.items():
            tally, began, before = tallies[name], time.process_time(), tallies[name].decisions
            for _ in range(decisions * (turn + 1) // slices - decisions * turn // slices):
                taken, steps, simulated = decide()
                tally.decisions += taken
                tally.steps += steps
                tally.simulated += simulated
            seconds = time.process_time() - began
            tally.seconds += seconds
            tally.slices += ((tally.decisions - before) / seconds,)
    print_table(tallies)


def print_table(tallies: dict[str, Tally]) -> None:
    """Print what was measured."""
    table = Table("design", "decisions/s", "least slice", "ratio", "steps/decision", "simulated s", "us/step")
    first = tallies["single"]
    for name, tally in tallies.items():
        rate = tally.decisions / tally.seconds
        table.add_row(
            name,
            f"{rate:.0f}",
            f"{min(tally.slices):.0f}",
            f"{rate * first.seconds / first.decisions:.2f}",
            f"{tally.steps / tally.decisions:.1f}",
            f"{tally.simulated / tally.decisions:.2f}",
            f"{1e6 * tally.seconds / tally.steps:.0f}",
        )
    Console().print(table)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
