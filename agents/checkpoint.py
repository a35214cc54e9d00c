"""Checkpoint files: safetensors and JSON, without executable content."""

import errno
import hashlib
import math
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import safetensors.torch
import torch
from gymnasium import spaces
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, NonNegativeInt, ValidationError, model_validator
from safetensors import SafetensorError
from torch import Tensor

from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.curves import Row, check_rows
from lidarnaut.agents.run_folder import RECORD_FILE, CheckpointError, find_best, list_checkpoints
from lidarnaut.agents.trust import check_names, resuming
from lidarnaut.envs.files import MAX_JSON_BYTES, explain_errors, printable, read_bytes, write_folder

POLICY_FILE = "policy.safetensors"
TRAINING_FILE = "training.safetensors"
MAX_SIZE = 100_000
"""Maximum length of an axis of a saved space, and maximum number of discrete actions."""
MAX_ELEMENTS = 10_000_000
"""Maximum number of elements of a saved observation or action space."""

Size = Annotated[int, Field(ge=1, le=MAX_SIZE)]


class SpaceRecord(BaseModel):
    """Gymnasium space in JSON: `Box` with uniform bounds, `Discrete` from 0, or `MultiBinary` with one axis."""

    # JSON has no infinity: infinite bounds are strings.
    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True, ser_json_inf_nan="strings")

    kind: Literal["Box", "Discrete", "MultiBinary"]
    shape: Annotated[tuple[Size, ...], Field(max_length=4)]
    """Shape of the space; (number of actions,) for a `Discrete`."""
    dtype: Literal["float32", "float64", "uint8", "int8", "int16", "int32", "int64", "bool"]
    low: float = 0.0
    high: float = 1.0

    @model_validator(mode="after")
    def _check(self) -> "SpaceRecord":
        if math.prod(self.shape) > MAX_ELEMENTS:
            raise ValueError(f"shape {self.shape} has more than {MAX_ELEMENTS:,} elements")
        if self.kind != "Box" and len(self.shape) != 1:
            raise ValueError(f"a {self.kind} has one axis, got shape {self.shape}")
        if not self.low <= self.high:
            raise ValueError(f"low must be at most high, got {self.low} and {self.high}")
        if np.dtype(self.dtype).kind in "iu":
            limits = np.iinfo(self.dtype)
            if self.low < limits.min or self.high > limits.max:
                raise ValueError(f"bounds {self.low:g} and {self.high:g} lie outside of {self.dtype}")
        return self

    @classmethod
    def of(cls, space: spaces.Space) -> "SpaceRecord":
        """Return the JSON description of a Gymnasium space; raise ValueError if unsupported."""
        dtype: Any = str(space.dtype)
        if isinstance(space, spaces.Box):
            low, high = float(space.low.min()), float(space.high.max())
            return cls(kind="Box", shape=space.shape, dtype=dtype, low=low, high=high)
        if isinstance(space, spaces.Discrete) and space.start == 0:
            return cls(kind="Discrete", shape=(int(space.n),), dtype=dtype)
        if isinstance(space, spaces.MultiBinary) and isinstance(space.n, int):
            return cls(kind="MultiBinary", shape=(space.n,), dtype=dtype)
        raise ValueError(f"only Box, Discrete from 0 and MultiBinary with one axis can be saved, got {space}")

    def space(self) -> spaces.Space:
        if self.kind == "Box":
            return spaces.Box(self.low, self.high, self.shape, np.dtype(self.dtype).type)
        return (spaces.Discrete if self.kind == "Discrete" else spaces.MultiBinary)(self.shape[0])

    def __str__(self) -> str:
        if self.kind == "Box":
            return f"Box({self.low:g}, {self.high:g}, {self.shape}, {self.dtype})"
        return f"{self.kind}({self.shape[0]})"


class Record(BaseModel):
    """Content of `checkpoint.json`: configuration, spaces, counters, random states and evaluations."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    format: Literal[2] = 2
    steps: NonNegativeInt
    updates: NonNegativeInt
    config: TrainingConfig
    observation: dict[str, SpaceRecord]
    action: SpaceRecord
    numpy_random: tuple[
        Literal["MT19937"], Annotated[int, Field(ge=0, le=624)], Annotated[int, Field(ge=0, le=1)], FiniteFloat
    ]
    action_random: dict[str, Any] = {}
    counters: dict[str, int | float] = {}
    control_hz: FiniteFloat
    replay: dict[Annotated[str, Field(pattern=r"^\d{12}-\d{12}\.safetensors$")], str] = {}
    """SHA-256 checksum of each replay buffer file by file name, oldest first."""
    evaluations: list[Row]
    sha256: dict[str, str] = {}


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """Training state between two updates: record, policy weights, and tensors for resuming."""

    record: Record
    policy: dict[str, Tensor]
    training: dict[str, Tensor]
    """Optimizer moments, other trained variables and random states, by name: `optimizer.<weight>.<moment>`,
    `variable.<name>`, `random.numpy`, `random.torch`."""


def save_checkpoint(checkpoint: Checkpoint, run: Path, keep: int) -> Path:
    """Write a checkpoint to a run folder, and delete all but the newest `keep` checkpoints and the best one.

    Raises:
        CheckpointError: if writing fails.
    """
    folder = run / "checkpoints" / f"step_{checkpoint.record.steps:09d}"
    save = safetensors.torch.save
    tensors = {POLICY_FILE: save(checkpoint.policy), TRAINING_FILE: save(checkpoint.training)}
    sha256 = {name: hashlib.sha256(content).hexdigest() for name, content in tensors.items()}
    record = checkpoint.record.model_copy(update={"sha256": sha256})
    try:
        write_folder(folder, {**tensors, RECORD_FILE: record.model_dump_json(indent=1)})
    except OSError as error:
        why = "no space is left on the disk" if error.errno == errno.ENOSPC else error.strerror or str(error)
        message = f"checkpoint {folder} could not be written: {why}."
        if older := list_checkpoints(run):
            again = resuming(run, record.config.model_dump())
            message += f" The newest complete checkpoint is {older[-1]}; resume with {again}"
        raise CheckpointError(message) from error
    best = find_best(run)
    for old in list_checkpoints(run)[:-keep]:
        if old != best:
            shutil.rmtree(old)
    return folder


def load_checkpoint(folder: str | Path, *, policy_only: bool = False, trust: Iterable[str] = ()) -> Checkpoint:
    """Read a checkpoint from a folder.

    `policy_only`: skip optimizer moments and random states, whose file may be missing. `trust`: modules, or names
    `module:attribute`, that the checkpoint may import.

    Raises:
        CheckpointError: if a file is missing, altered or invalid.
        ValueError: if the checkpoint names code that is not trusted.
    """
    folder, tensors = Path(folder), []
    try:
        # ValueError covers invalid encodings, invalid JSON and too deep nesting.
        record = Record.model_validate_json(read_bytes(folder / RECORD_FILE, MAX_JSON_BYTES))
        if not policy_only:
            check_rows(record.evaluations)
        for name in (POLICY_FILE,) if policy_only else (POLICY_FILE, TRAINING_FILE):
            content = read_bytes(folder / name)
            if hashlib.sha256(content).hexdigest() != record.sha256.get(name):
                raise SafetensorError(f"{name} was altered or truncated ({len(content)} bytes): its checksum differs")
            tensors.append(load_tensors(name, content))
    except (OSError, SafetensorError) as error:
        raise damaged(folder, str(error)) from error
    except ValidationError as error:
        raise damaged(folder, f"{RECORD_FILE}: {'; '.join(explain_errors(error, Record)[:3])}") from error
    except ValueError as error:
        raise damaged(folder, f"{RECORD_FILE}: {error}") from error
    check_names(record.config.model_dump(), str(folder / RECORD_FILE), trust)
    return Checkpoint(record, *tensors, *([{}] if policy_only else []))


def load_tensors(name: str, content: bytes) -> dict[str, Tensor]:
    """Return the tensors of a safetensors file; raise SafetensorError if invalid or not finite."""
    try:
        tensors = safetensors.torch.load(content)
    except (SafetensorError, ValueError, KeyError, AttributeError, TypeError, RuntimeError) as error:
        raise SafetensorError(f"{name}: {type(error).__name__}: {error}") from error
    for key, tensor in tensors.items():
        if tensor.is_floating_point() and not torch.isfinite(tensor.float()).all():
            raise SafetensorError(f"{name}: {key!r} contains non-finite numbers")
    return tensors


def damaged(folder: Path, why: str) -> CheckpointError:
    """Return the error that a checkpoint is damaged, with the reason `why` and a remedy."""
    older = [path for path in list_checkpoints(folder.parent.parent) if path.name < folder.name]
    remedy = f"use the previous checkpoint, {older[-1]}" if older else "the run has no earlier checkpoint"
    return CheckpointError(f"checkpoint {folder} is damaged: {printable(why)}; {remedy}")


def check_tensors(folder: Path, name: str, given: dict[str, Tensor], needed: dict[str, Tensor]) -> None:
    """Raise CheckpointError if names, dtypes or shapes of saved tensors differ from those of the model."""
    for key in sorted(needed.keys() | given.keys()):
        if key not in given:
            raise damaged(folder, f"{name} lacks the tensor {key!r}")
        if key not in needed:
            raise damaged(folder, f"{name} has an unknown tensor {key!r}")
        have, want = (f"{str(t.dtype).removeprefix('torch.')} {tuple(t.shape)}" for t in (given[key], needed[key]))
        if have != want:
            raise damaged(folder, f"{name}: {key!r} is {have}, the network of its configuration needs {want}")
