"""How long explorers take to decide, step by step: `python -m benchmarks.decisions`.

Each explorer explores one world from the same start, kinematic physics, TinySLAM in the loop. What is timed is each
`act`, by the processor time of its thread: what else the machine does hardly adds to that. A robot steered at 10 Hz
misses a control period where one takes 100 ms or more. With `--robots 4` a team explores, and its `act` decides for
all robots.
"""

import time
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from rich.table import Table

import envs  # noqa: F401  (registers the environments)
from baselines import EXPLORERS, RrtTeam, make_explorer
from baselines.episode import begin_episode, decide_with, run
from envs.command_line import Count, make_console, run_command
from envs.core import lidar_env_of

TEAM = "rrt_team"
"""What explores with several robots."""
WARM_UP = 2
"""Decisions that are not counted: kernels are loaded, or compiled, in them."""


class Decisions(NamedTuple):
    """Processor times of the decisions of one episode [ms]."""

    count: int
    mean: float
    p99: float
    longest: float
    missed: int
    """How many took the control period or longer."""
    explored: float
    """Truly known share of the explorable area at the end."""


def time_decisions(world: str, name: str, seed: int = 0, max_time: float = np.inf, num_robots: int = 1) -> Decisions:
    """Let an explorer, or `TEAM`, explore with the world's usual robot for at most so long [s]; time its decisions."""
    settings: dict[str, Any] = {"world": world, "physics": "kinematic", "split": "test", "disable_env_checker": True}
    explorer: Any = RrtTeam() if name == TEAM else make_explorer(name)
    if name == TEAM:
        env = gymnasium.make("lidarnaut/ExploreTeam-v0", num_robots=num_robots, **settings)
    else:
        env = gymnasium.make("lidarnaut/Explore-v0", **settings)
    start = begin_episode(env, explorer, seed, np.random.default_rng([seed, 1]))
    period = lidar_env_of(env).control_period
    ended = run(env, decide_with(explorer, env), *start, max_steps=max_time / period, clock=time.thread_time)
    env.close()
    taken = np.array(ended.decision_times[WARM_UP:])
    times = (1e3 * float(time) for time in (taken.mean(), np.percentile(taken, 99), taken.max()))
    missed = np.count_nonzero(taken >= period)
    return Decisions(len(taken), *times, int(missed), ended.info["explored_fraction"])


def main(
    world: str = "tugbot_warehouse",
    explorers: tuple[str, ...] = tuple(name for name in EXPLORERS if name != "oracle"),
    seed: int = 0,
    max_time: float = np.inf,
    robots: Count = 1,
) -> None:
    """Print how long explorers take to decide.

    Args:
        world: Where they explore, with the world's usual robot.
        explorers: Explorers by name.
        seed: Seed of the episode: the same start for all of them.
        max_time: When to stop even if there is more to explore [s].
        robots: If more than one, a team of so many explores instead of the explorers.
    """
    table = Table("explorer", "decisions", "mean [ms]", "p99 [ms]", "max [ms]", "missed", "explored", title=world)
    for name in explorers if robots == 1 else (TEAM,):
        found = time_decisions(world, name, seed, max_time, robots)
        times = [f"{value:.2f}" for value in (found.mean, found.p99, found.longest)]
        table.add_row(name, str(found.count), *times, str(found.missed), f"{100 * found.explored:.1f} %")
    make_console().print(table)


if __name__ == "__main__":
    run_command(main)
