"""How many decisions per second `lidarnaut/ExploreFrontiers-v0` takes: `python -m benchmarks.decisions_throughput`.

Rooms of 20 m x 20 m, TurtleBot3 Burger (360 beams of 3.5 m), Hector, kinematic physics, always the nearest frontier.
Each design explores for as many decisions in each of its environments, so that maps small and large are in all figures;
they take turns in short slices, all in one process pinned to one core. What counts is processor time: the wall clock of
a shared machine also measures other processes. Worlds that are drawn ahead in the background count as well.
"""

import os
import time
from collections.abc import Callable

import numpy as np
from gymnasium.vector import AutoresetMode
from rich.table import Table

from envs.command_line import Count, make_console, run_command
from envs.explore_frontiers import ExploreFrontiersEnv
from envs.vector import ExploreFrontiersVectorEnv

WORLD = {"world": "rooms", "world_size": (20.0, 20.0), "physics": "kinematic"}
WARM_UP = 3
"""Decisions before the clock starts: they compile, and draw the first worlds."""


Decide = Callable[[], tuple[int, int, float]]
"""Decides once in every environment; returns decisions, control steps and simulated time [s]."""


def single() -> Decide:
    """Return what decides in a single environment."""
    env = ExploreFrontiersEnv(**WORLD)
    env.reset(seed=0)

    def decide() -> tuple[int, int, float]:
        *_, terminated, truncated, info = env.step(np.int64(0))
        if terminated or truncated:
            env.reset()
        return 1, info["decision_steps"], info["decision_time"]

    return decide


def vector(count: int) -> Decide:
    """Return the same for a number of sub-environments."""
    env = ExploreFrontiersVectorEnv(count, num_workers=0, autoreset_mode=AutoresetMode.NEXT_STEP, **WORLD)
    env.reset(seed=0)
    nearest = np.zeros(count, dtype=np.int64)

    def decide() -> tuple[int, int, float]:
        *_, info = env.step(nearest)
        taken = info["outcome"] != "reset"
        return np.count_nonzero(taken), info["decision_steps"].sum(), info["decision_time"].sum()

    return decide


def main(decisions: Count = 600, slices: Count = 20, sizes: tuple[int, ...] = (16, 64, 256)) -> None:
    """Measure and print a table.

    Args:
        decisions: of each environment; 600 take them through about two thirds of an episode.
        slices: into how many turns these are divided.
        sizes: numbers of sub-environments that are compared with the single environment.
    """
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    designs = {"single": single(), **{f"{count} sub-environments": vector(count) for count in sizes}}
    done = {name: np.zeros((slices, 4)) for name in designs}
    for decide in designs.values():
        for _ in range(WARM_UP):
            decide()
    for turn in range(slices):
        for name, decide in designs.items():
            began = time.process_time()
            for _ in range(decisions * (turn + 1) // slices - decisions * turn // slices):
                done[name][turn, :3] += decide()
            done[name][turn, 3] = time.process_time() - began
    table = Table("design", "decisions/s", "least slice", "ratio", "steps/decision", "simulated s", "us/step")
    rate_of_first = None
    for name, turns in done.items():
        taken, steps, simulated, seconds = turns.sum(axis=0)
        rate = taken / seconds
        rate_of_first = rate_of_first or rate
        table.add_row(
            name,
            f"{rate:.0f}",
            f"{(turns[:, 0] / turns[:, 3]).min():.0f}",
            f"{rate / rate_of_first:.2f}",
            f"{steps / taken:.1f}",
            f"{simulated / taken:.2f}",
            f"{1e6 * seconds / steps:.0f}",
        )
    make_console().print(table)


if __name__ == "__main__":
    run_command(main)
