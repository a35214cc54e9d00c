"""What the parameters of the navigator change: `python -m benchmarks.navigator_params max_time=2 inflation=0.3`.

Time to 95 % of an explorer with one parameter changed, against the same explorer from the same starts; kinematic
physics.
"""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Annotated

import numpy as np
import tyro
from rich.table import Table

from baselines import make_explorer
from baselines.episode import run_episode
from baselines.frontier.explorer import RuleExplorer
from benchmarks.parallel import run_each
from envs.command_line import Count, make_console, run_command
from envs.core import LidarEnv
from envs.tasks.explore import Explore

WORLDS = (
    *("turtlebot3_house", "aws_small_house", "rrt_house", "explorebench_loop", "create3_maze"),
    *("rooms", "maze", "caves"),
)
"""Library worlds and families of different sizes."""
CHANGES = (
    *("max_time=2", "max_time=8", "max_time=inf", "min_time=0.5", "min_time=2", "frontier_radius=0.25"),
    *("frontier_radius=0.7", "goal_tolerance=1", "stuck_time=20", "inflation=0.3", "inflation=0.6"),
    *("max_extent=1", "max_extent=4"),
)
"""What is tried if nothing is asked for; `max_time` is the explorer's, the others are the navigator's."""


def change_explorer(explorer: RuleExplorer, name: str, value: float) -> None:
    """Set a parameter by its name.

    Raises:
        ValueError: if there is none of that name.
    """
    if name == "max_time":
        explorer.max_time = value
    elif name in {field.name for field in fields(explorer.params)}:
        explorer.params = replace(explorer.params, **{name: value})
    elif name in {field.name for field in fields(explorer.planning)}:
        explorer.planning = replace(explorer.planning, **{name: value})
    else:
        allowed = ["max_time", *(field.name for part in (explorer.params, explorer.planning) for field in fields(part))]
        raise ValueError(f"{name} is no parameter of the navigator; there are {', '.join(allowed)}")


def time_explorer(name: str, change: str, slam: str, world: str, seed: int) -> float:
    """Return the time to 95 % [s]; the time limit where it was not reached."""
    explorer = make_explorer(name)
    if not isinstance(explorer, RuleExplorer):
        raise ValueError(f"explorer must be a rule over candidates, got {name}")
    if change:
        parameter, _, value = change.partition("=")
        change_explorer(explorer, parameter, float(value))
    env = LidarEnv(Explore, world=world, slam=slam, physics="kinematic", target_coverage=0.95)
    episode = run_episode(env, explorer, seed)
    env.close()
    return min(episode.time_to_95, episode.time_limit)


def main(
    changes: Annotated[tuple[str, ...], tyro.conf.Positional] = CHANGES,
    explorer: str = "nearest",
    worlds: tuple[str, ...] = WORLDS,
    seeds: Count = 5,
    slam: str = "truth",
    jobs: Count = 2,
) -> None:
    """Measure and print a table.

    Args:
        changes: `name=value` of the parameters to change, one at a time.
        explorer: a rule over candidates.
        worlds: names of worlds.
        seeds: starts in each.
        slam: as in `ExploreEnv`.
        jobs: number of processes.
    """
    starts = [(world, seed) for world in worlds for seed in range(seeds)]
    tasks = [(explorer, change, slam, *start) for change in ("", *changes) for start in starts]
    times = np.reshape(run_each(time_explorer, tasks, jobs, unit="episode"), (1 + len(changes), len(starts)))
    print_changes(f"{explorer}, {slam}, {len(starts)} paired starts", changes, times)


def print_changes(title: str, changes: Sequence[str], times: np.ndarray) -> None:
    """Print what changes do to times [s], shape (1 + changes, starts): without a change, and with each."""
    table = Table("change", "time to 95 %, mean change and 95 % interval", "earlier", "later")
    for change, ratios in zip(changes, np.log(times[1:] / times[0]), strict=True):
        mean, margin = 100.0 * ratios.mean(), 196.0 * ratios.std(ddof=1) / np.sqrt(len(ratios))
        sooner, later = np.count_nonzero(ratios < 0), np.count_nonzero(ratios > 0)
        table.add_row(change, f"{mean:+.1f} % ± {margin:.1f}", str(sooner), str(later))
    make_console().print(title, table)


if __name__ == "__main__":
    run_command(main)
