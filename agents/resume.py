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
    **dict.fromkeys(("sweep", "seeds", "exclude"), "sweep"),
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
DEFAULT = "the default"
"""Stands for the value of a key that is left out."""
Config = TrainingConfig | EvolutionConfig | Mapping[str, Any]


def check_changes(now: Config, kind: str, run: Path, was: Config | None = None) -> None:
    """Compare the configuration that a run, or a checkpoint, is to go on with to its former one.

    `kind` is one of `MAY_CHANGE`; `was` None stands for the configuration in the run. A sweep's are mappings.

    Raises:
        CheckpointError: a key changes that must not; names it, both values, and the keys that may change.
    """
    was = was or parse_config(read_mapping(run / "config.yaml"), str(run / "config.yaml"))
    old, new = (one if isinstance(one, Mapping) else one.model_dump(mode="json") for one in (was, now))
    wrong = []
    for key, before, value, kinds in _changes(old, new):
        if kind not in kinds:
            wrong.append(f"another {key}: it needs {key}: {SHORT.repr(before)}, and not {SHORT.repr(value)}")
        elif key in ("total_steps", "generations") and value < (done := count_done(run)) and value < before:
            wrong.append(f"{done} of {key}, and cannot end at {value}")
    if wrong:
        allowed = ", ".join(key for key, kinds in MAY_CHANGE.items() if kind in kinds)
        raise CheckpointError(f"{run} holds {'; '.join(wrong)}; on resume ({kind}), these may change: {allowed}")


def _changes(
    was: Mapping[str, Any], now: Mapping[str, Any], kinds: str = "", above: str = ""
) -> Iterator[tuple[str, Any, Any, str]]:
    """Yield each changed key, such as `environment.world`, both values, and the kinds of runs that may change it.

    A run's hyperparameters and network are complete; keys that `now` leaves out there are no changes.
    """
    for name in now if above.startswith(("hyperparameters.", "network.")) else {**was, **now}:
        key, value = f"{above}{name}", now.get(name, DEFAULT)
        before, below = was.get(name, {} if isinstance(value, Mapping) else DEFAULT), MAY_CHANGE.get(key, kinds)
        if isinstance(before, Mapping) and isinstance(value, Mapping):
            yield from _changes(before, value, below, f"{key}.")
        elif value != before:
            yield key, before, value, below
