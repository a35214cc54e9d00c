"""Train a policy.

python train.py --config configs/rooms_small.yaml --seed 1 [--total-steps 100_000] [--hyperparameters.gamma 0.98] ...
python train.py --config configs/explore_frontiers.yaml --seed 1 [--generations 40] ...
python train.py --config configs/completion.yaml --seed 1 [--episodes 600] ...
lidarnaut-train --config explore_frontiers --seed 1     installed package with its configurations
python train.py --resume runs/rooms_small__1__20250101-120000
python train.py --environment.id lidarnaut/ReachCrowd-v0 [--algorithm SAC]     the recipe of the id

A configuration starts from the recipe of its environment.id, configs/recipes/ID.yaml; --recipe None: from nothing.
Every key of the configuration is an option, with dots between nested names: --environment.world caves,
--environment.observations scan motion, --environment.reward.time -0.1, --environment.time-limit None.
--hyperparameters.NAME is an argument of the algorithm's class, --network.NAME a key of NetworkConfig.
--trust MODULE ... names modules of your own that a run folder may use.
--seeds 0 1 2 trains a sweep, one run per seed; --jobs 2 trains two at a time.
"""

import argparse
import ast
import contextlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import yaml

from lidarnaut.agents.config import OTHER_KINDS, TrainingConfig
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.agents.training import train
from lidarnaut.envs.command_line import begin_command, fail, parse_options, show_log
from lidarnaut.envs.files import LockedError, printable


def main(arguments: list[str] | None = None) -> int:
    """Read the command line and train; return the exit status."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    begin = parser.add_mutually_exclusive_group()
    begin.add_argument("--config")
    begin.add_argument("--resume", type=Path)
    parser.add_argument("--trust", nargs="+", action="extend", default=[])
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--help", "-h", action="store_true")
    args, others = parser.parse_known_args(begin_command(arguments))
    if args.help:
        for kind in (TrainingConfig, *OTHER_KINDS.values()):
            with contextlib.suppress(SystemExit):
                parse_options(kind, ["--help"], description=f"{__doc__}\n{kind.__doc__}")
        return 0
    show_log("lidarnaut.agents")
    try:
        changes = read_changes(others)
        if args.resume is None and args.config is None and not {"algorithm", "environment.id"} & changes.keys():
            raise ValueError(
                "pass --environment.id ID, a configuration, --config FILE, or a run to resume, --resume RUN"
            )
        options = {"trust": args.trust, "jobs": args.jobs}
        run = train(args.config, changes, resume=args.resume, **options)
    except KeyboardInterrupt as error:
        fail(f"stopped {error}".rstrip())
        return 130
    except (CheckpointError, LockedError, ValueError, OSError, ImportError, gymnasium.error.Error) as error:
        return fail(error)
    if int(os.environ.get("RANK", 0)) == 0:  # of torchrun
        print(f"results are in {printable(run)}")
    return 0


def read_changes(words: Sequence[str]) -> dict[str, Any]:
    """Parse options such as `--network.speed 0.6` into values by key; several values form a list.

    Raises:
        ValueError: if a value precedes the first option or is not valid YAML.
    """
    found: dict[str, list[Any]] = {}
    key = None
    for word in words:
        if word.startswith("--"):
            key, equals, value = word[2:].partition("=")
            key = key.replace("-", "_")
            found[key] = [read_value(value)] if equals else []
        elif key is None:
            raise ValueError(f"unknown argument {word!r}; options begin with --")
        else:
            found[key].append(read_value(word))
    return {key: values[0] if len(values) == 1 else values or True for key, values in found.items()}


def read_value(text: str) -> Any:
    """Parse a number, boolean, None, YAML list, YAML mapping, or text; ValueError for invalid YAML."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, TypeError):
        pass
    try:
        return yaml.safe_load(text) if text.startswith(("[", "{")) else text
    except yaml.YAMLError as error:
        raise ValueError(f"{text!r} is not readable as YAML: {error}") from error


if __name__ == "__main__":
    sys.exit(main())
