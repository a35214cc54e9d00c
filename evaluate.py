"""Compare explorers on the same places with the same seeds."""

import json as json_format
import sys
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from benchmarks.arena.publish import publish, run_with_progress
from benchmarks.arena.runner import Evaluation
from benchmarks.arena.settings import Settings
from benchmarks.arena.summary import terminal_table, to_json


def evaluate(
    policies: tuple[str, ...],
    worlds: tuple[str, ...],
    out: Path,
    episodes: int = 10,
    robot: str | None = None,
    physics: str = "bullet",
    slam: str = "tinyslam",
    time_limit: float | None = None,
    seed: int = 0,
    jobs: int = 1,
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Compare explorers on the same places with the same seeds.

    Writes episodes.csv, summary.json, curves and maps as PNG, and report.html. Run again, it goes on where it stopped.

    Args:
        policies: Classic explorers by name (random, nearest, frontier, tour, explore_lite, greedy_gain,
            next_best_view, wall_follower, rrt), learned ones as ppo:PATH of a run folder or, with a name of your own,
            LABEL=ppo:PATH.
        worlds: Library worlds, procedural families (their test split), or paths of world files.
        out: Folder for the results.
        episodes: Episodes of each policy in each world.
        robot: Robot; by default each world's usual one.
        physics: bullet or kinematic.
        slam: tinyslam, odometry or truth.
        time_limit: Length of an episode [s]; by default it grows with the place.
        seed: Seed of the first episode; the next ones count up.
        jobs: Processes to spread the episodes over. Decision times are cleanest with one per core or fewer.
        json: Print the summary as JSON, and nothing else, to the standard output.
    """
    messages = Console(stderr=True)
    try:
        settings = Settings(policies, worlds, episodes, seed, robot, physics, slam, time_limit)
        evaluation = Evaluation(settings, out)
    except (ValueError, RuntimeError, ImportError, OSError) as error:
        messages.print(f"evaluate.py: {error}", style="red", markup=False, highlight=False)
        sys.exit(2)
    try:
        rows = run_with_progress(evaluation, jobs, messages)
        summary = publish(rows, settings, out)
    except KeyboardInterrupt:
        messages.print(f"Interrupted. The finished episodes are in {out}; the same command goes on from there.")
        sys.exit(130)
    except OSError as error:
        messages.print(f"evaluate.py: {error}; the same command goes on from what is in {out}", style="red")
        sys.exit(2)
    if json:
        print(json_format.dumps(to_json(summary), indent=1))
        return
    for world in worlds:
        Console().print(terminal_table(summary, world))
    messages.print(
        f"Interquartile means [95 % intervals]. Report: {out / 'report.html'}", highlight=False, markup=False
    )


if __name__ == "__main__":
    tyro.cli(evaluate)
