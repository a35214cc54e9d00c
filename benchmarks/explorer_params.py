"""What parameters of a classic explorer change: `python -m benchmarks.explorer_params frontier min_goal_distance=0`.

Time to 95 % with parameters changed, against the same explorer from the same starts, on tasks that training draws
(`agents.frontiers.tasks`): no world that is held out is seen. Kinematic physics.
"""

from dataclasses import fields, replace
from inspect import signature
from typing import Annotated, Any

import numpy as np
import tyro

from agents.frontiers.tasks import Task, draw_task, make_world
from baselines import EXPLORERS
from baselines.episode import run_episode
from baselines.explorer import Explorer
from benchmarks.navigator_params import change_explorer, print_changes
from benchmarks.parallel import run_each
from envs.command_line import Count, run_command
from envs.core import LidarEnv
from envs.tasks.explore import Explore

FAMILIES = ("rooms", "maze", "warehouse", "caves")
"""Procedural families of the tasks."""


def make_changed(name: str, changes: str) -> Explorer:
    """Return an explorer with parameters changed.

    Args:
        name: of an explorer that has parameters.
        changes: `name=value`, several joined by commas, of the explorer's parameters and of the navigator's; none for
            the explorer as it is.

    Raises:
        ValueError: if there is no explorer or no parameter of that name.
    """
    make: Any = EXPLORERS.get(name)
    given = signature(make).parameters.get("params") if make else None
    if given is None:
        raise ValueError(f"{name!r} is no explorer with parameters")
    values = dict(change.split("=") for change in filter(None, changes.split(",")))
    params: Any = given.default
    own = {field.name: type(getattr(params, field.name)) for field in fields(params)}
    explorer = make(replace(params, **{key: own[key](value) for key, value in values.items() if key in own}))
    for key in values.keys() - own.keys():
        change_explorer(explorer, key, float(values[key]))
    return explorer


def time_explorer(name: str, changes: str, slam: str, task: Task) -> float:
    """Return the time to 95 % [s]; the time limit where it was not reached."""
    env = LidarEnv(
        Explore, world=make_world(task), robot=task.robot, slam=slam, physics="kinematic", target_coverage=0.95
    )
    episode = run_episode(env, make_changed(name, changes), task.seed)
    env.close()
    return max(min(episode.time_to_95, episode.time_limit), env.control_period)


def main(
    explorer: Annotated[str, tyro.conf.Positional],
    changes: Annotated[tuple[str, ...], tyro.conf.Positional],
    tasks: Count = 24,
    seed: int = 0,
    slam: str = "truth",
    jobs: Count = 2,
) -> None:
    """Measure and print a table.

    Args:
        explorer: with parameters: frontier, tour, rrt, ...
        changes: `name=value` of parameters, several at once joined by commas.
        tasks: how many worlds, robots and starts are drawn.
        seed: draws them.
        slam: as in `ExploreEnv`.
        jobs: number of processes.
    """
    drawn = [draw_task(np.random.default_rng([seed, i]), FAMILIES) for i in range(tasks)]
    work = [(explorer, change, slam, task) for change in ("", *changes) for task in drawn]
    times = np.reshape(run_each(time_explorer, work, jobs, unit="episode"), (1 + len(changes), tasks))
    print_changes(f"{explorer}, {slam}, {tasks} paired tasks", changes, times)


if __name__ == "__main__":
    run_command(main)
