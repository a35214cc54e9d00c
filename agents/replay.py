"""Replay buffer on disk, in files that are written once."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from safetensors import SafetensorError
from stable_baselines3.common.buffers import ReplayBuffer

from lidarnaut.agents.checkpoint import load_tensors
from lidarnaut.agents.run_folder import RECORD_FILE, CheckpointError, list_checkpoints
from lidarnaut.envs.files import own_folder, read_bytes, read_json, write_file

FOLDER = "replay"
ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
"""Names of the saved arrays of a replay buffer, shape (buffer_size, num_envs, ...) each."""


class ReplayFiles:
    """Saves new transitions of a replay buffer, and loads the files of a checkpoint.

    Each step adds a transition of every sub-environment. File names contain the index of the first step and the index
    after the last step.
    """

    def __init__(self, buffer: ReplayBuffer, run: Path) -> None:
        self._buffer, self._folder = buffer, run / FOLDER
        self._sums: dict[str, str] = {}
        self._end = self._offset = 0

    def write(self, end: int) -> dict[str, str]:
        """Save new transitions; return SHA-256 checksums of all replay buffer files, by file name.

        `end`: number of steps of each sub-environment so far. Raises CheckpointError if writing fails.
        """
        size = self._buffer.buffer_size
        end -= (end - self._offset) % size != self._buffer.pos
        first = max(self._end, end - size)
        if first < end:
            slots = (np.arange(first, end) - self._offset) % size
            rows = {name: torch.from_numpy(array[slots]) for name, array in _arrays(self._buffer)}
            name, content = f"{first:012d}-{end:012d}.safetensors", safetensors.torch.save(rows)
            try:
                own_folder(self._folder)
                write_file(self._folder / name, content)
            except OSError as error:
                raise CheckpointError(f"the replay buffer could not be written: {error}") from error
            self._sums[name] = hashlib.sha256(content).hexdigest()
            self._end = end
        self._sums = {name: digest for name, digest in self._sums.items() if _end_of(name) > end - size}
        return dict(self._sums)

    def read(self, sums: dict[str, str]) -> None:
        """Fill the buffer from files with SHA-256 checksums `sums`; CheckpointError if damaged or missing."""
        buffer, count = self._buffer, 0
        if sums:
            self._sums, self._end = dict(sums), _end_of(list(sums)[-1])
            self._offset = max(int(next(iter(sums)).partition("-")[0]), self._end - buffer.buffer_size)
        for name, digest in sums.items():
            path = self._folder / name
            try:
                content = read_bytes(path)
                if hashlib.sha256(content).hexdigest() != digest:
                    raise SafetensorError("its checksum differs")
                rows = load_tensors(name, content)
                skipped = max(self._offset - int(name.partition("-")[0]), 0)
                for key, array in _arrays(buffer):
                    new = rows[key].numpy()[skipped:]
                    array[count : count + len(new)] = new
            except (OSError, SafetensorError, KeyError, ValueError) as error:
                raise CheckpointError(f"{path} of the replay buffer is damaged: {error}") from error
            count += len(new)
        buffer.pos, buffer.full = count % buffer.buffer_size, count == buffer.buffer_size

    def prune(self, run: Path) -> None:
        """Delete replay buffer files that no checkpoint uses."""
        needed = {name for one in list_checkpoints(run) for name in read_json(one / RECORD_FILE).get("replay", {})}
        for path in self._folder.glob("*.safetensors"):
            if path.name not in needed:
                path.unlink()


def _end_of(name: str) -> int:
    return int(name.removesuffix(".safetensors").partition("-")[2])


def _arrays(buffer: ReplayBuffer) -> Iterator[tuple[str, np.ndarray]]:
    for name in ARRAYS:
        value: Any = getattr(buffer, name)
        for key, array in value.items() if isinstance(value, dict) else [("all", value)]:
            yield f"{name}.{key}", array
