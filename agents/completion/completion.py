"""Prediction of floor by a trained network, and its files."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from safetensors import SafetensorError

from lidarnaut.agents.frontiers.score import RECORD_FILE, WEIGHTS_FILE
from lidarnaut.agents.frontiers.tasks import SPLIT
from lidarnaut.agents.inference import one_thread
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.baselines.frontier.expected_map import Prediction
from lidarnaut.envs.files import printable, read_bytes, read_json, write_folder
from lidarnaut.envs.geometry import OccupancyGrid

from .network import CompletionNetwork, channels_of
from .raster import CELL, turned_raster, wall_direction

KIND = "completion"
"""Value of `kind` in the record of a policy folder that holds a completion."""


class Completion:
    """Predicts the floor beyond the known part of a map."""

    def __init__(self, network: CompletionNetwork) -> None:
        self.network, self._angle = network, math.nan

    def reset(self) -> None:
        """Forget the direction of the last map's walls."""
        self._angle = math.nan

    def __call__(self, grid: OccupancyGrid) -> Prediction:
        """Return the probability that cells around the known part of a map belong to the explorable floor."""
        self._angle = wall_direction(grid, self._angle)
        raster = turned_raster(grid, self._angle)
        return Prediction(self.probabilities(raster.codes), raster.angle, raster.corner, CELL)

    def probabilities(self, codes: np.ndarray) -> np.ndarray:
        """Return the probability of floor of each cell, shape (height, width), float32. `codes`: of `TurnedRaster`."""
        self.network.eval()
        with one_thread(), torch.inference_mode():
            probability: np.ndarray = torch.sigmoid(self.network(channels_of(codes[None])))[0].numpy()
        return probability

    def save(self, folder: Path, record: Mapping[str, Any]) -> None:
        """Write the network to a folder, with training results `record` and names of held-out worlds and robots."""
        about = {"format": 1, "kind": KIND, **SPLIT, **record}
        tensors = {name: value.detach().contiguous() for name, value in self.network.state_dict().items()}
        weights = safetensors.torch.save(tensors)
        write_folder(folder, {WEIGHTS_FILE: weights, RECORD_FILE: json.dumps(about, indent=2) + "\n"})

    @classmethod
    def load(cls, folder: str | Path) -> "Completion":
        """Load a network from a folder; raise CheckpointError if unreadable."""
        folder, network = Path(folder), CompletionNetwork()
        try:
            if read_json(folder / RECORD_FILE)["kind"] != KIND:
                raise ValueError(f"its kind is not {KIND!r}")
            network.load_state_dict(safetensors.torch.load(read_bytes(folder / WEIGHTS_FILE)))
        except (OSError, ValueError, KeyError, TypeError, RuntimeError, RecursionError, SafetensorError) as error:
            raise CheckpointError(f"{folder} holds no readable completion: {printable(error)}") from error
        return cls(network)
