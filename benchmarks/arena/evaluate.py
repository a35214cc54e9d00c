"""Evaluation of policies as a Python function, like the command-line script `evaluate.py`."""

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from lidarnaut.benchmarks.arena.episodes import Summary
from lidarnaut.benchmarks.arena.publish import publish, run_with_progress
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import USUAL, Settings
from lidarnaut.envs.files import parse_record
from lidarnaut.envs.ids import EXPLORE


def evaluate(
    policies: Sequence[str] | Mapping[str, Any],
    worlds: Sequence[str] | Mapping[str, Any] = (USUAL,),
    *,
    id: str = EXPLORE,
    arguments: Mapping[str, Any] | None = None,
    people: Iterable[int | str] = (USUAL,),
    robots: Sequence[str] = (USUAL,),
    physics: Sequence[str] = (USUAL,),
    slam: Sequence[str] = (USUAL,),
    episodes: int = 10,
    seed: int = 0,
    out: str | Path | None = None,
    jobs: int = 1,
    trust: Iterable[str] = (),
) -> Summary:
    """Run policies in the same worlds with the same seeds and return the statistics.

    Args:
        policies: classic policies by name, trained policies as `ppo:PATH`, your own as `module:attribute`; or a mapping
            from names to functions without arguments that make a policy.
        worlds: names, paths or `module:attribute`; or a mapping from names to `World` objects. `"usual"` is the
            environment's default.
        id: id of the environment.
        arguments: further arguments of the environment.
        people: numbers of people, or crowds by name.
        robots: names, paths or `module:attribute` of robots.
        physics: `"bullet"`, `"kinematic"`, or both.
        slam: names of SLAM algorithms, or of localizers in environments with a known map.
        episodes: number of episodes of each policy in each world.
        seed: seed of the first episode; each further episode adds 1.
        out: folder for tables, figures and `report.html`. An evaluation in the same folder is resumed. None keeps no
            files.
        jobs: number of processes.
        trust: modules, or names `module:attribute`, of your own code that learned policies may import.

    Returns:
        Statistics by policy, case (world, robot, ...) and measure: interquartile mean, 95 % interval, number of
        episodes, and number that missed the threshold.

    Raises:
        ValueError: if an argument is wrong or no episode could be run; lists allowed values.
        lidarnaut.agents.run_folder.CheckpointError: if a learned policy is missing or damaged.
    """
    own = {**(policies if isinstance(policies, Mapping) else {}), **(worlds if isinstance(worlds, Mapping) else {})}
    listed = {"policies": policies, "worlds": worlds, "robots": robots, "physics": physics, "slam": slam}
    content: dict[str, Any] = {name: list(values) for name, values in listed.items()}
    content |= {"id": id, "arguments": dict(arguments or {}), "people": [*map(str, people)]}
    content |= {"episodes": episodes, "seed": seed}
    settings = parse_record(content, "evaluate", Settings)
    with tempfile.TemporaryDirectory() as scratch:
        evaluation = Evaluation(settings, Path(scratch if out is None else out), custom=own, trust=trust)
        run_with_progress(evaluation, jobs, Console(stderr=True))
        return publish(evaluation)
