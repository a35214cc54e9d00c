"""How long explorers take to decide, step by step: `python -m benchmarks.decisions`.

Each explorer explores one place from the same start, kinematic physics, TinySLAM in the loop. What is timed is each
`act`, by the processor time of its thread: what else the machine does hardly adds to that. A robot steered at 10 Hz
misses a beat where one takes 100 ms or more.
"""

import time
from dataclasses import dataclass

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from baselines import EXPLORERS, make_explorer
from envs.explore import ExploreEnv

WARM_UP = 2
"""Decisions that are not counted: kernels are loaded, or compiled, in them."""


@dataclass(frozen=True, slots=True)
class Decisions:
    """Processor times of the decisions of one episode."""

    count: int
    """How many were timed."""
    mean: float
    """Mean [ms]."""
    p99: float
    """99th percentile [ms]."""
    longest: float
    """Greatest [ms]."""
    missed: int
    """How many took the control period or longer."""
    explored: float
    """Truly known share of the explorable area at the end."""


def time_decisions(world: str, name: str, seed: int = 0, max_time: float = np.inf) -> Decisions:
    """Let an explorer explore, and time its decisions.

    Args:
        world: as the environment takes it; explored with its usual robot.
        name: of the explorer.
        seed: of the episode.
        max_time: when to stop even if there is more to explore [s].
    """
    env = ExploreEnv(world=world, physics="kinematic", split="test")
    observation, info = env.reset(seed=seed)
    explorer = make_explorer(name)
    explorer.reset(env.robot, env.control_period, np.random.default_rng([seed, 1]))
    spent = []
    while explorer.end_reason is None and "end_reason" not in info and info["time"] < max_time:
        began = time.thread_time()
        action = explorer.act(observation, env.belief)
        spent.append(time.thread_time() - began)
        observation, _, _, _, info = env.step(action)
    env.close()
    taken = np.array(spent[WARM_UP:])
    return Decisions(
        count=len(taken),
        mean=1e3 * float(taken.mean()),
        p99=1e3 * float(np.percentile(taken, 99)),
        longest=1e3 * float(taken.max()),
        missed=int(np.count_nonzero(taken >= env.control_period)),
        explored=info["explored_fraction"],
    )


def main(
    world: str = "tugbot_warehouse",
    explorers: tuple[str, ...] = tuple(name for name in EXPLORERS if name != "oracle"),
    seed: int = 0,
    max_time: float = np.inf,
) -> None:
    """Print how long explorers take to decide.

    Args:
        world: Where they explore, with the world's usual robot.
        explorers: Explorers by name.
        seed: Seed of the episode: the same start for all of them.
        max_time: When to stop even if there is more to explore [s].
    """
    table = Table("explorer", "decisions", "mean [ms]", "p99 [ms]", "max [ms]", "missed", "explored", title=world)
    for name in explorers:
        found = time_decisions(world, name, seed, max_time)
        times = [f"{value:.2f}" for value in (found.mean, found.p99, found.longest)]
        table.add_row(name, str(found.count), *times, str(found.missed), f"{100 * found.explored:.1f} %")
    Console().print(table)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
