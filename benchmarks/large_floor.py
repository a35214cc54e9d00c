"""What exploration costs as the map grows: `python -m benchmarks.large_floor`.

One burger explores a generated floor, 200 m x 60 m by default, with `nearest`, ground truth for a pose, and
kinematic physics. Processor time by explored area: of the choices (candidates, rule and path), of a control period
of the explorer in between, and of everything, as a multiple of real time.
"""

import time
from itertools import pairwise
from typing import Any

import numpy as np
from rich.table import Table

from baselines import make_explorer
from baselines.episode import begin_episode, decide_with, run
from envs.command_line import make_console, run_command
from envs.core import LidarEnv
from envs.tasks.explore import Explore

DECISION = 4
"""A control period counts as a choice if it took this many times as long as the median one."""


def main(
    explorer: str = "nearest",
    world_size: tuple[float, float] = (200.0, 60.0),
    slam: str = "truth",
    seed: int = 0,
    max_time: float = np.inf,
    areas: tuple[float, ...] = (0, 1000, 2000, 3000, 4000, 5000, 6000, 7000, 8000, 9000, 1e9),
) -> None:
    """Explore, and print a table.

    Args:
        explorer: Explorer by name.
        world_size: Outer size of the floor [m].
        slam: SLAM by name.
        seed: Of the floor and everything else.
        max_time: When to stop even if there is more to explore [s].
        areas: Borders between the rows of the table, explored area [m2].
    """
    began = time.process_time()
    env = LidarEnv(
        Explore,
        world="rooms",
        world_size=world_size,
        robot="turtlebot3_burger",
        slam=slam,
        physics="kinematic",
        time_limit=1e6,
    )
    chosen = make_explorer(explorer)
    observation, info = begin_episode(env, chosen, seed, np.random.default_rng([seed, 1]))
    reset_time = time.process_time() - began
    areas_known, times = [], []

    def watch(info: dict[str, Any]) -> None:
        areas_known.append(info["explored_area"])
        times.append(time.process_time())

    steps = max_time / env.control_period
    ended = run(env, decide_with(chosen, env), observation, info, watch, max_steps=steps, clock=time.process_time)
    rows = np.column_stack([areas_known[1:], ended.decision_times[: len(times) - 1], np.diff(times)])
    print_table(rows, areas, env.control_period, reset_time, ended.info)


def print_table(
    rows: np.ndarray, areas: tuple[float, ...], period: float, reset_time: float, info: dict[str, object]
) -> None:
    """Print what was measured; rows: shape (n, 3), float64: explored area [m2], time of the choice, and of all [s]."""
    rows = rows[50:]  # kernels are loaded, or compiled, in the first ones
    is_choice = rows[:, 1] > DECISION * np.median(rows[:, 1])
    table = Table("explored [m2]", "choices", "choice [ms]", "p99 [ms]", "between [us]", "times real time")
    for low, high in pairwise(areas):
        inside = (rows[:, 0] >= low) & (rows[:, 0] < high)
        choices = 1e3 * rows[inside & is_choice, 1]
        if len(choices):
            table.add_row(
                f"{low:g} to {min(high, rows[:, 0].max()):.0f}",
                str(len(choices)),
                f"{choices.mean():.2f}",
                f"{np.percentile(choices, 99):.2f}",
                f"{1e6 * rows[inside & ~is_choice, 1].mean():.0f}",
                f"{period * np.count_nonzero(inside) / rows[inside, 2].sum():.0f}",
            )
    console = make_console()
    console.print(table)
    console.print(
        f"{info['explored_fraction']:.1%} in {info['time']:.0f} s, {info.get('end_reason')}; reset {reset_time:.1f} s; "
        f"whole episode {period * len(rows) / rows[:, 2].sum():.0f} times real time"
    )


if __name__ == "__main__":
    run_command(main)
