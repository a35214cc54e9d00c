"""The state of a training on disk: tensors as safetensors, the rest as JSON, nothing that runs code when read."""

import errno
import hashlib
import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import safetensors.torch
from gymnasium import spaces
from pydantic import BaseModel, ConfigDict, ValidationError
from safetensors import SafetensorError
from torch import Tensor

from agents.config import TrainingConfig
from agents.curves import Row
from agents.run_folder import RECORD_FILE, CheckpointError, list_checkpoints
from envs.files import explain_errors, write_folder

POLICY_FILE = "policy.safetensors"
"""The network's weights."""
TRAINING_FILE = "training.safetensors"
"""The optimizer's moments and the random generators' states."""


class BoxRecord(BaseModel):
    """A `gymnasium.spaces.Box` with the same bounds for every element."""

    model_config = ConfigDict(extra="forbid")

    shape: tuple[int, ...]
    dtype: str
    low: float
    high: float

    @classmethod
    def of(cls, box: spaces.Box) -> "BoxRecord":
        return cls(shape=box.shape, dtype=str(box.dtype), low=float(box.low.min()), high=float(box.high.max()))

    def space(self) -> spaces.Box:
        return spaces.Box(self.low, self.high, self.shape, np.dtype(self.dtype).type)

    def __str__(self) -> str:
        return f"Box({self.low:g}, {self.high:g}, {self.shape}, {self.dtype})"


class DiscreteRecord(BaseModel):
    """A `gymnasium.spaces.Discrete` that starts from 0."""

    model_config = ConfigDict(extra="forbid")

    n: int

    def space(self) -> spaces.Discrete:
        return spaces.Discrete(self.n)

    def __str__(self) -> str:
        return f"Discrete({self.n})"


class MultiBinaryRecord(BaseModel):
    """A `gymnasium.spaces.MultiBinary` with one axis."""

    model_config = ConfigDict(extra="forbid")

    bits: int

    def space(self) -> spaces.MultiBinary:
        return spaces.MultiBinary(self.bits)

    def __str__(self) -> str:
        return f"MultiBinary({self.bits})"


SpaceRecord = BoxRecord | DiscreteRecord | MultiBinaryRecord


def record_of(space: spaces.Space) -> SpaceRecord:
    """Return the record of a space.

    Raises:
        ValueError: if it is of a kind that cannot be saved.
    """
    if isinstance(space, spaces.Box):
        return BoxRecord.of(space)
    if isinstance(space, spaces.Discrete) and space.start == 0:
        return DiscreteRecord(n=int(space.n))
    if isinstance(space, spaces.MultiBinary) and isinstance(space.n, int):
        return MultiBinaryRecord(bits=space.n)
    raise ValueError(f"only Box, Discrete from 0 and MultiBinary with one axis can be saved, got {space}")


class Record(BaseModel):
    """What `checkpoint.json` holds."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    format: Literal[1] = 1
    """Version of this format."""
    steps: int
    """Environment steps taken."""
    updates: int
    """Passes over the samples made."""
    config: TrainingConfig
    """The experiment."""
    observation: dict[str, SpaceRecord]
    """Observation space."""
    action: SpaceRecord
    """Action space."""
    numpy_random: tuple[str, int, int, float]
    """State of NumPy's global generator but for its key: name, position, Gaussian kept?, that Gaussian."""
    evaluations: list[Row]
    """Rows of `evaluations.csv` so far."""
    sha256: dict[str, str] = {}
    """Checksum of each file of tensors."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The state of a training between two updates."""

    record: Record
    """Everything that is not a tensor."""
    policy: dict[str, Tensor]
    """The network's weights by name."""
    training: dict[str, Tensor]
    """`optimizer.<weight>.<moment>`, `random.numpy`, `random.torch`; empty where only the policy was kept."""


def save_checkpoint(checkpoint: Checkpoint, run: Path, keep: int) -> Path:
    """Write a checkpoint into a run folder, then remove all but the newest `keep`.

    Raises:
        CheckpointError: if it cannot be written, a full disk for example; the older ones are untouched.
    """
    folder = run / "checkpoints" / f"step_{checkpoint.record.steps:09d}"
    try:
        _write(checkpoint, folder)
    except OSError as error:
        why = "no space is left on the disk" if error.errno == errno.ENOSPC else error.strerror or str(error)
        older = list_checkpoints(run)
        remedy = f"The newest complete one is {older[-1]}; go on from it with --resume {run}" if older else ""
        raise CheckpointError(f"checkpoint {folder} could not be written: {why}. {remedy}".rstrip()) from error
    for old in list_checkpoints(run)[:-keep]:
        shutil.rmtree(old)
    return folder


def save_policy(checkpoint: Checkpoint, folder: Path) -> None:
    """Write a checkpoint without the state of its training to a new folder: to act, and not to go on from."""
    _write(replace(checkpoint, training={}), folder)


def _write(checkpoint: Checkpoint, folder: Path) -> None:
    given = {POLICY_FILE: checkpoint.policy, TRAINING_FILE: checkpoint.training}
    tensors = {name: safetensors.torch.save(content) for name, content in given.items() if content}
    sha256 = {name: hashlib.sha256(content).hexdigest() for name, content in tensors.items()}
    record = checkpoint.record.model_copy(update={"sha256": sha256})
    write_folder(folder, {**tensors, RECORD_FILE: record.model_dump_json(indent=1)})


def load_checkpoint(folder: Path) -> Checkpoint:
    """Read a checkpoint.

    Raises:
        CheckpointError: if a file is missing, cut short, altered or no JSON; names it and an older checkpoint.
    """
    tensors: list[dict[str, Tensor]] = []
    try:
        # Undecodable text and broken JSON are ValueErrors alike.
        record = Record.model_validate(json.loads((folder / RECORD_FILE).read_text()))
        for name in (POLICY_FILE, TRAINING_FILE):
            if name == TRAINING_FILE and name not in record.sha256:  # see `save_policy`
                tensors.append({})
                continue
            content = (folder / name).read_bytes()
            if hashlib.sha256(content).hexdigest() != record.sha256.get(name):
                raise SafetensorError(f"{name} is not what was written ({len(content)} bytes): its checksum differs")
            tensors.append(safetensors.torch.load(content))
    except (OSError, SafetensorError) as error:
        raise damaged(folder, str(error)) from error
    except ValidationError as error:
        raise damaged(folder, f"{RECORD_FILE}: {'; '.join(explain_errors(error, Record)[:3])}") from error
    except ValueError as error:
        raise damaged(folder, f"{RECORD_FILE}: {error}") from error
    return Checkpoint(record, *tensors)


def damaged(folder: Path, why: str) -> CheckpointError:
    """Return the error that says that a checkpoint cannot be used, and what can be used instead."""
    older = [path for path in list_checkpoints(folder.parent.parent) if path.name < folder.name]
    remedy = f"use the one before it, {older[-1]}" if older else "there is none before it in this run"
    return CheckpointError(f"checkpoint {folder} is damaged: {why}; {remedy}")


def check_tensors(folder: Path, name: str, given: dict[str, Tensor], needed: dict[str, Tensor]) -> None:
    """Hold the tensors of a file against those that the network or the optimizer needs.

    Raises:
        CheckpointError: if one is missing, unknown, or has another shape or dtype.
    """
    for key in sorted(needed.keys() | given.keys()):
        if key not in given:
            raise damaged(folder, f"{name} lacks the tensor {key!r}")
        if key not in needed:
            raise damaged(folder, f"{name} has an unknown tensor {key!r}")
        have, want = (f"{str(t.dtype).removeprefix('torch.')} {tuple(t.shape)}" for t in (given[key], needed[key]))
        if have != want:
            raise damaged(folder, f"{name}: {key!r} is {have}, the network of its configuration needs {want}")
