"""How long explorers take to decide, step by step: `python -m benchmarks.decisions`.

Each explorer explores one world from the same start, kinematic physics, TinySLAM in the loop. What is timed is each
`act`, by the processor time of the process: what else the machine does hardly adds to that. A robot steered at 10 Hz
misses a control period where one takes 100 ms or more. With `--robots 4` a team explores, and its `act` decides for
all robots.
"""

from typing import NamedTuple

import gymnasium
import numpy as np
from rich.table import Table

import envs  # noqa: F401  (registers the environments)
from baselines import EXPLORERS, policies_for
from baselines.episode import run_episode
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
    id, team = ("ExploreTeam", {"num_robots": num_robots}) if name == TEAM else ("Explore", {})
    limit = {"time_limit": max_time} if np.isfinite(max_time) else {}
    env = gymnasium.make(f"lidarnaut/{id}-v0", world=world, physics="kinematic", split="test", **limit, **team)
    env.reset(seed=seed)
    episode, period = run_episode(env, policies_for(env)[name](), seed), lidar_env_of(env).control_period
    env.close()
    taken = episode.decision_times[WARM_UP:]
    times = (1e3 * float(time) for time in (taken.mean(), np.percentile(taken, 99), taken.max()))
    missed = np.count_nonzero(taken >= period)
    return Decisions(len(taken), *times, int(missed), episode.explored_fraction)


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
