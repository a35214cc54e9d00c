"""Benchmarks of SLAM, localization and planning: `python -m lidarnaut.benchmarks.drives STAGE`."""

import functools
import operator
from collections.abc import Callable
from typing import Annotated, Any

import tyro

from lidarnaut.benchmarks.drives.localization import compare_amcl, compare_on_log
from lidarnaut.benchmarks.drives.recording import Row, table
from lidarnaut.benchmarks.drives.slams import compare_kidnapped, compare_slams
from lidarnaut.benchmarks.drives.teams import compare_teams
from lidarnaut.envs.command_line import make_console, run_command

STAGES: dict[str, Callable[..., list[Row]]] = {
    "slam": compare_slams,
    "kidnapping": compare_kidnapped,
    "localization": compare_amcl,
    "localization-log": compare_on_log,
    "teams": compare_teams,
}


def _later(function: Callable[..., Any]) -> Callable[..., Callable[[], Any]]:
    return functools.wraps(function)(lambda **options: functools.partial(function, **options))


PARSERS = [Annotated[Any, tyro.conf.subcommand(name, constructor=_later(stage))] for name, stage in STAGES.items()]


def main(stage: Annotated[functools.reduce(operator.or_, PARSERS), tyro.conf.arg(name="")]) -> None:
    """Run a benchmark, and print its table.

    Args:
        stage: benchmark to run.
    """
    make_console().print(table(stage()))


if __name__ == "__main__":
    run_command(main, config=(tyro.conf.CascadeSubcommandArgs, tyro.conf.OmitSubcommandPrefixes))
