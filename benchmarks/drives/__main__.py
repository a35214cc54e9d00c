"""Benchmarks of SLAM, localization and planning: `python -m lidarnaut.benchmarks.drives STAGE`."""

import functools
import json
import operator
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from lidarnaut.benchmarks.drives.driving import compare_driving, measure_loads
from lidarnaut.benchmarks.drives.localization import compare_amcl, compare_on_log
from lidarnaut.benchmarks.drives.recording import Row, table
from lidarnaut.benchmarks.drives.slams import compare_kidnapped, compare_slams
from lidarnaut.benchmarks.drives.teams import compare_teams
from lidarnaut.benchmarks.drives.times import time_amcl, time_planning
from lidarnaut.envs.command_line import make_console, run_command

STAGES: dict[str, Callable[..., list[Row]]] = {
    "slam": compare_slams,
    "kidnapping": compare_kidnapped,
    "localization": compare_amcl,
    "localization-log": compare_on_log,
    "localization-times": time_amcl,
    "planning": time_planning,
    "teams": compare_teams,
    "driver": compare_driving,
    "driver-load": measure_loads,
}


def _later(function: Callable[..., Any]) -> Callable[..., Callable[[], Any]]:
    return functools.wraps(function)(lambda **options: functools.partial(function, **options))


PARSERS = [Annotated[Any, tyro.conf.subcommand(name, constructor=_later(stage))] for name, stage in STAGES.items()]


@dataclass(frozen=True)
class Command:
    """Command-line options of the benchmarks on recorded drives."""

    stage: Annotated[functools.reduce(operator.or_, PARSERS), tyro.conf.arg(name="")]
    """Benchmark to run."""
    json: Path | None = None
    """Also write the table to this JSON file. Times of events that never happened are null."""


def main(command: Command) -> None:
    rows = command.stage()
    make_console().print(table(rows))
    if command.json is not None:
        command.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    run_command(main, options=Annotated[Command, tyro.conf.CascadeSubcommandArgs, tyro.conf.OmitSubcommandPrefixes])
