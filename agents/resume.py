"""Keys of a configuration that may change when a run goes on."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from lidarnaut.agents.config import EvolutionConfig, TrainingConfig, parse_config
from lidarnaut.agents.run_folder import CheckpointError, count_done
from lidarnaut.envs.files import SHORT, read_mapping

MAY_CHANGE = {
    "total_steps": "training, sweep",
    "generations": "evolution, sweep",
    "validate_every": "evolution",
    "num_workers": "evolution, sweep",
    "environment": "training",
    "environment.id": "",
    **dict.fromkeys(("environment.num_workers", "environment.vectorization"), "training, sweep"),
    "evaluation.every": "training",
    **dict.fromkeys(("checkpoints", "device", "torch_threads"), "training, sweep"),
    "hyperparameters": "training",
    **dict.fromkeys((f"hyperparameters.{name}" for name in ("ent_coef", "policy_kwargs", "use_sde")), ""),
}
"""Kinds of runs that may change a key, and the keys below it, on resume. The longest key counts; others are fixed."""
Config = TrainingConfig | EvolutionConfig


def check_changes(now: Config, kind: str, run: Path, was: Config | None = None) -> None:
    """Compare the configuration that a run, or a checkpoint, is to go on with to its former one.

    `kind` is one of `MAY_CHANGE`; `was` None stands for the configuration in the run. Hyperparameters that `now` leaves
    out are not compared.

    Raises:
        CheckpointError: a key changes that must not; names it, both values, and the keys that may change.
    """
    if was is None:
        was = parse_config(read_mapping(run / "config.yaml"), str(run / "config.yaml"))
    before, done, wrong = dict(_flatten(was.model_dump(mode="json"))), count_done(run), []
    for key, value in _flatten(now.model_dump(mode="json")):
        known = before.get(key)
        if (value != known or key not in before) and kind not in _kinds(key):
            wrong.append(f"another {key}: it needs {key}: {SHORT.repr(known)}, and not {SHORT.repr(value)}")
        elif key in ("total_steps", "generations") and known is not None and value < min(known, done):
            wrong.append(f"{done} of {key}, and cannot end at {value}")
    if wrong:
        allowed = ", ".join(key for key, kinds in MAY_CHANGE.items() if kind in kinds)
        raise CheckpointError(f"{run} holds {'; '.join(wrong)}; on resume of a {kind}, these may change: {allowed}")


def _kinds(key: str) -> str:
    """Return the kinds of runs that may change a key."""
    while key not in MAY_CHANGE and "." in key:
        key = key.rpartition(".")[0]
    return MAY_CHANGE.get(key, "")


def _flatten(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield nested values by keys such as `environment.world`."""
    for key, value in values.items():
        inside = _flatten(value, f"{above}{key}.") if isinstance(value, Mapping) else [(f"{above}{key}", value)]
        yield from inside
