"""Trainings, evolutions and sweeps over seeds, begun or resumed from Python or from the command line."""

import logging
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from lidarnaut.agents.config import (
    OTHER_KINDS,
    CompletionConfig,
    Config,
    EvolutionConfig,
    change,
    find_configuration,
    parse_config,
)
from lidarnaut.agents.recipes import with_recipe
from lidarnaut.agents.run_folder import GENERATIONS, RECORD_FILE, SWEEP, VERSIONS, find_config
from lidarnaut.agents.trust import check_names, named_code
from lidarnaut.envs.files import read_mapping

DEFAULTS = {"experiment": "plain", "total_steps": 300_000}
"""Settings without a configuration, for ids without a recipe."""
LOGGER = logging.getLogger(__name__)
RECORDS = (VERSIONS, RECORD_FILE, GENERATIONS, SWEEP, "checkpoints")
"""Files of run, sweep and policy folders. A configuration in such a folder may only name trusted code."""


def train(
    config: str | Path | Mapping[str, Any] | Config | None = None,
    changes: Mapping[str, Any] | None = None,
    *,
    run: str | Path | None = None,
    resume: str | Path | None = None,
    trust: Iterable[str] = (),
    jobs: int = 1,
    progress: bool = True,
) -> Path:
    """Train a policy and return the folder of the run.

    Args:
        config: name of a packaged configuration such as `"reach_crowd"`, path of a YAML file, nested mapping, or
            configuration object. A name, file or mapping changes the recipe, the packaged configuration of its
            `environment.id`; an object and the configuration of a run folder are used as they are. None: the recipe
            of the `environment.id` in `changes`.
        changes: new values by key, with dots between the names of nested keys: `{"environment.world": "caves"}`.
        run: folder for the results, by default `runs/<experiment>__<seed>__<time>`.
        resume: folder of a run or sweep, or of a checkpoint, to resume. It replaces `config`, except an object.
        trust: modules, or names `module:attribute`, of your own code that the resumed run may import.
        jobs: number of trainings of a sweep that run in parallel on this machine.
        progress: whether to show progress bars.

    Raises:
        ValueError: if the configuration is invalid (the message names the key and the allowed values), `run` holds a
            run, or training diverges.
        lidarnaut.agents.run_folder.CheckpointError: if the run to resume is missing or damaged.
        lidarnaut.envs.files.LockedError: if another process writes to the run.
        KeyboardInterrupt: on Ctrl-C, after the state has been saved; the message names the run.
    """
    is_shared = "TORCHELASTIC_RUN_ID" in os.environ  # by torchrun, whose process 0 reads the rest
    if is_shared and int(os.environ["RANK"]):
        from lidarnaut.agents.learning import follow_remotely

        return follow_remotely()
    changes, trust = dict(changes or {}), tuple(trust)
    run, resume = (None if path is None else Path(path) for path in (run, resume))
    if run and resume:
        raise ValueError(f"a run to resume has its own folder, {resume}: leave out run")
    data, source = _read(config, resume, changes, trust)
    if is_shared and ("seeds" in data or data.get("algorithm") in OTHER_KINDS):
        raise ValueError("torchrun starts single trainings by reinforcement learning, not sweeps and other kinds")
    # Importing torch takes seconds, so report mistakes in the configuration first.
    if "seeds" in data and data.get("algorithm") == "completion":
        raise ValueError("seeds are for reinforcement learning and evolutions: train completions one by one, by seed")
    if "seeds" in data:
        from lidarnaut.agents.seeds import train_seeds

        return train_seeds(data, source, run=resume or run, jobs=jobs, progress=progress)
    return _train(parse_config(data, source), run=run, resume=resume, trust=trust, progress=progress)


def _train(parsed: Config, *, run: Path | None, resume: Path | None, trust: tuple[str, ...], progress: bool) -> Path:
    """Train by a configuration of any kind. `trust`: for reinforcement learning alone."""
    if isinstance(parsed, EvolutionConfig):
        from lidarnaut.agents.frontiers.evolution import evolve

        return evolve(parsed, run=run, resume=resume, progress=progress)
    if isinstance(parsed, CompletionConfig):
        from lidarnaut.agents.completion.training import train_completion

        return train_completion(parsed, run=run, resume=resume, progress=progress)
    from lidarnaut.agents.learning import run_training

    return run_training(parsed, run=run, resume=resume, trust=trust, progress=progress)


def _read(
    config: Any, resume: Path | None, changes: Mapping[str, Any], trust: tuple[str, ...]
) -> tuple[dict[str, Any], str]:
    """Return a changed configuration as nested mappings, with its recipe unless it is complete; and its origin."""
    source, is_complete = "the configuration", isinstance(config, BaseModel)
    if is_complete:
        data = _mapping(config)
    elif resume is None and not isinstance(config, str | Path):
        data = dict(config or {})
    else:
        path = find_configuration(str(config), "experiment") if resume is None else find_config(resume)
        data, source = read_mapping(path), str(path)
        is_complete = resume is not None or any((path.parent / name).exists() for name in RECORDS)
        if is_complete:
            check_names(data, source, [*trust, *named_code(changes)])
    data = change(data, changes)
    if is_complete:
        return data, source
    data, text = with_recipe(data)
    LOGGER.info("%s", text or "no recipe")
    return (data if config is not None else {**DEFAULTS, **data}), source


def _mapping(config: BaseModel) -> dict[str, Any]:
    """Return a configuration as nested mappings. User-defined objects, such as robots and crowds, are kept."""
    return {key: _mapping(value) if isinstance(value, BaseModel) else value for key, value in config}
