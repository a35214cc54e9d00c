"""Train a policy.

python train.py --config configs/rooms_small.yaml --seed 1 [--total-steps 100_000] [--hyperparameters.gamma 0.98] ...
python train.py --config configs/explore_frontiers.yaml --seed 1 [--generations 40] ...
lidarnaut-train --config explore_frontiers --seed 1     where the package is installed, which brings configurations
python train.py --resume runs/rooms_small__1__20250101-120000

Every key of the configuration is an option, with dots between the names: --environment.world caves,
--environment.observations scan motion, --environment.reward.time -0.1, --environment.time-limit None.
--ray ADDRESS runs a sweep, or an evolution, on a Ray cluster.
"""

import argparse
import sys
from pathlib import Path

import gymnasium

from agents.config import EvolutionConfig, parse_config
from agents.options import change, describe_keys, read_changes
from agents.run_folder import CheckpointError, find_config
from envs.command_line import fail, program_name
from envs.files import LockedError, read_mapping
from lidarnaut.configurations import find_configuration


def main(arguments: list[str] | None = None) -> int:
    """Read the command line and train; return the exit status."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--config")
    where.add_argument("--resume", type=Path)
    parser.add_argument("--ray")
    parser.add_argument("--help", "-h", action="store_true")
    given, others = parser.parse_known_args(arguments)
    if given.help:
        print(f"usage: {program_name()} (--config FILE | --resume RUN) [--KEY VALUE ...]\n\n{__doc__}{describe_keys()}")
        return 0
    try:
        if given.resume is None and given.config is None:
            raise ValueError("name a configuration, --config FILE, or a run that is to go on, --resume RUN")
        path = find_configuration(given.config) if given.resume is None else find_config(given.resume)
        data = change(read_mapping(path), read_changes(others))
        run = start(data, str(path), given.resume, given.ray)
    except KeyboardInterrupt as error:
        fail(f"stopped {error}".rstrip())
        return 130
    except (CheckpointError, LockedError, ValueError, OSError, ImportError, gymnasium.error.Error) as error:
        return fail(error)
    print(f"results are in {run}")
    return 0


def start(data: dict, source: str, resume: Path | None, ray: str | None) -> Path:
    """Start, or go on with, what a configuration asks for; return the folder of the results. Raises as `train`."""
    # Torch takes seconds to load: mistakes in the configuration are reported at once.
    if {"sweep", "seeds"} & data.keys():
        from agents.sweep import run_sweep

        return run_sweep(data, source, resume=resume, ray=ray)
    config = parse_config(data, source)
    if isinstance(config, EvolutionConfig):
        from agents.frontiers.evolution import evolve

        return evolve(config, resume=resume, ray=ray)
    if ray is not None:
        raise ValueError("--ray is for sweeps and evolutions: a training by itself runs in one place")
    from agents.training import train

    return train(config, resume=resume)


if __name__ == "__main__":
    sys.exit(main())
