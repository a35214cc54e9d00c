"""Train an explorer.

python train.py --config configs/rooms_small.yaml --seed 1 [--total-steps 100_000] [--ppo.learning-rate 1e-3] ...
python train.py --config configs/explore_frontiers.yaml --seed 1 [--generations 40] ...
lidarnaut-train --config explore_frontiers --seed 1     where the package is installed, which brings configurations
python train.py --resume runs/rooms_small__1__20250101-120000
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import gymnasium
import tyro

from agents.config import EvolutionConfig, TrainingConfig
from agents.run_folder import CheckpointError, find_config
from envs.command_line import fail, read_options
from envs.files import LockedError, read_mapping, read_record
from lidarnaut.configurations import find_configuration


def main(arguments: list[str] | None = None) -> int:
    """Read the command line and train; return the exit status."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--config")
    where.add_argument("--resume", type=Path)
    given, overrides = parser.parse_known_args(arguments)
    try:
        kind: Any = TrainingConfig
        start: Any = tyro.MISSING
        if given.resume is not None or given.config is not None:
            path = find_configuration(given.config) if given.resume is None else find_config(given.resume)
            kind = EvolutionConfig if "algorithm" in read_mapping(path) else TrainingConfig
            start = read_record(path, kind)
        elif not {"--help", "-h"} & {*overrides}:
            raise ValueError("name a configuration, --config FILE, or a run that is to go on, --resume RUN")
        config = read_options(kind, overrides, default=start, description=__doc__)
        # Torch takes seconds to load: mistakes above are reported at once.
        if isinstance(config, EvolutionConfig):
            from agents.frontiers.evolution import evolve

            run = evolve(config, resume=given.resume)
        else:
            from agents.training import train

            run = train(config, resume=given.resume)
    except KeyboardInterrupt as error:
        fail(f"stopped {error}".rstrip())
        return 130
    except (CheckpointError, LockedError, ValueError, OSError, ImportError, gymnasium.error.Error) as error:
        return fail(error)
    print(f"results are in {run}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
