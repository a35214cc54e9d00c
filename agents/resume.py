"""Resumed runs, and configuration keys that may change."""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from lidarnaut.agents.config import Config, parse_config
from lidarnaut.agents.run_folder import CheckpointError, count_done, new_run, prepare_folder
from lidarnaut.envs.files import SHORT, Lock, own_folder, read_mapping

MAY_CHANGE = {
    "total_steps": "training, sweep",
    "generations": "evolution, sweep",
    "seeds": "sweep",
    "validate_every": "evolution, completion",
    "num_workers": "evolution, completion, sweep",
    "environment": "training",
    "environment.id": "",
    **dict.fromkeys(("environment.num_workers", "environment.vectorization"), "training, sweep"),
    **dict.fromkeys((f"evaluation.{name}" for name in ("every", "test_episodes", "references")), "training"),
    **dict.fromkeys(("checkpoints", "device", "logger"), "training, sweep"),
    "processes": "training, sweep",
    "torch_threads": "training, completion, sweep",
    "hyperparameters": "training",
    **dict.fromkeys((f"hyperparameters.{name}" for name in ("ent_coef", "policy_kwargs", "use_sde")), ""),
}
"""Configuration keys, and the kinds of runs (training, evolution, completion, sweep) that can be resumed with a new
value; an empty text for none. Nested keys without an entry are treated like their parent key."""
DEFAULT = "the default"
AnyConfig = Config | Mapping[str, Any]


@contextlib.contextmanager
def begin(config: Config, kind: str, run: Path | None, resume: Path | None) -> Iterator[Path]:
    """Create and lock a run folder, see `new_run`, or lock that of a run to resume with a configuration.

    `kind`: `evolution` or `completion`. Raises CheckpointError if `resume` is no run folder, or a fixed key changes.
    """
    if resume is None:
        with new_run(config, run) as folder:
            yield folder
        return
    if not (resume / "config.yaml").exists():
        raise CheckpointError(f"{resume} is not a run folder: it has no config.yaml")
    with Lock(own_folder(resume)):
        check_changes(config, kind, resume)
        prepare_folder(resume, config)
        yield resume


def check_changes(now: AnyConfig, kind: str, run: Path, was: AnyConfig | None = None) -> None:
    """Raise CheckpointError if a resumed run changes a configuration key that must stay fixed.

    `kind`: `training`, `evolution`, `completion` or `sweep`. `run`: folder of the run or checkpoint. `was`: previous
    configuration; None reads it from `run`.
    """
    was = was or parse_config(read_mapping(run / "config.yaml"), str(run / "config.yaml"))
    old, new = (one if isinstance(one, Mapping) else one.model_dump(mode="json") for one in (was, now))
    wrong = []
    for key, before, value, kinds in _changes(old, new):
        if kind not in kinds:
            wrong.append(f"{key}: {SHORT.repr(before)}, not {SHORT.repr(value)}")
        elif key in ("total_steps", "generations") and value < (done := count_done(run)) and value < before:
            wrong.append(f"{done} of {key}, more than {value}")
    if wrong:
        allowed = ", ".join(key for key, kinds in MAY_CHANGE.items() if kind in kinds)
        raise CheckpointError(f"{run} holds {'; '.join(wrong)}; keys that may change on resume ({kind}): {allowed}")


def _changes(
    was: Mapping[str, Any], now: Mapping[str, Any], kinds: str = "", above: str = ""
) -> Iterator[tuple[str, Any, Any, str]]:
    for name in now if above.startswith(("hyperparameters.", "network.")) else {**was, **now}:
        key, value = f"{above}{name}", now.get(name, DEFAULT)
        before, below = was.get(name, {} if isinstance(value, Mapping) else DEFAULT), MAY_CHANGE.get(key, kinds)
        if isinstance(before, Mapping) and isinstance(value, Mapping):
            yield from _changes(before, value, below, f"{key}.")
        elif value != before:
            yield key, before, value, below
