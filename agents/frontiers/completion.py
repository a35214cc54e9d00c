"""Completed maps: a network that says which unknown cells are blocked, and the areas in view that follow from it.

What a rule counts as in view behind a frontier ends, in truth, at walls that no scan has met. A U-Net (Ronneberger,
Fischer and Brox, "U-Net: convolutional networks for biomedical image segmentation", 2015) learns from known plans what
walls and rooms are like; map completion for exploration follows Shrestha et al., "Learned map prediction for enhanced
mobile robot exploration" (2019).
"""

import itertools
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from numba import njit
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.nn import functional

from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.envs.navigation import FrontierNavigator
from lidarnaut.envs.navigation.costmap import OCCUPIED_FROM
from lidarnaut.envs.navigation.views import NUM_RAYS, RAYS

from .score import COMPLETION_FILE

SIDE = 64
"""Cells along a side of what the network sees around a viewpoint."""
CELL = 0.2
"""Side of such a cell [m]."""
UNKNOWN, FREE, BLOCKED = 0, 1, 2
"""What is known of a cell."""
CHANNELS = 24, 48, 96, 128
"""Channels of the network, from the finest cells to the coarsest."""
CAUTION = 0.5
"""Exponent of the chance that a cell on a ray is free: neighbours are blocked together, which chances do not say."""


@njit(cache=True, error_model="numpy")
def crop(joined, frame, x, y, out):
    """Write what is known around a point (x, y), map frame [m], to `out`, shape (SIDE, SIDE), uint8.

    `joined`: occupancy of planning cells, shape (height, width), int8; `frame`: position (x, y) of its corner and side
    of a cell [m]. A cell of the crop is blocked where one below it is occupied, else free where one is free.
    """
    height, width = joined.shape
    left, low, side = frame
    count = max(1, math.ceil(CELL / side - 1e-6))
    for i in range(SIDE):
        for j in range(SIDE):
            found = UNKNOWN
            for k in range(count * count):
                by = y + CELL * (i - SIDE / 2 + (k // count + 0.5) / count)
                bx = x + CELL * (j - SIDE / 2 + (k % count + 0.5) / count)
                row, col = math.floor((by - low) / side), math.floor((bx - left) / side)
                if 0 <= row < height and 0 <= col < width and joined[row, col] >= 0:
                    found = max(found, BLOCKED if joined[row, col] >= OCCUPIED_FROM else FREE)
            out[i, j] = found


@njit(cache=True, error_model="numpy")
def expected_area(known, blocked, reach, caution):
    """Return the unknown area that a lidar in the middle is expected to see [m2].

    `known`: a crop; `blocked`: chance that a cell is blocked, of the same shape, float32; `reach`: length of rays
    [cells]; `caution`: see `CAUTION`. Rays end at the edge of the crop.
    """
    total = 0.0
    for k in range(NUM_RAYS):
        d_row, d_col = RAYS[k]
        y = x = SIDE / 2
        chance = 1.0
        for step in range(1, reach + 1):
            y += d_row
            x += d_col
            row, col = math.floor(y), math.floor(x)
            if row < 0 or row >= SIDE or col < 0 or col >= SIDE or known[row, col] == BLOCKED:
                break
            if known[row, col] == UNKNOWN:
                free = 1.0 - blocked[row, col]
                total += step * chance * free
                chance *= free**caution
                if chance < 0.01:
                    break
    return total * (2.0 * math.pi / NUM_RAYS) * CELL * CELL


class _Block(nn.Sequential):
    """A convolution that may halve the side, and one that keeps it."""

    def __init__(self, inputs: int, outputs: int, side: int, stride: int) -> None:
        first = nn.Conv2d(inputs, outputs, side, stride, padding=1)
        super().__init__(first, nn.ReLU(), nn.Conv2d(outputs, outputs, 3, padding=1), nn.ReLU())


class CompletionNetwork(nn.Module):
    """From crops, shape (batch, SIDE, SIDE), uint8, to logits that cells are blocked, of that shape, float32."""

    def __init__(self) -> None:
        super().__init__()
        pairs = [*itertools.pairwise(CHANNELS)]
        self.down = nn.ModuleList([_Block(2, CHANNELS[0], 4, 2), *(_Block(a, b, 4, 2) for a, b in pairs)])
        self.narrow = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in reversed(pairs))
        self.up = nn.ModuleList(nn.Conv2d(a, a, 3, padding=1) for a, _ in reversed(pairs))
        self.out = nn.Conv2d(CHANNELS[0], 4, 1)
        for module in self.modules():
            if isinstance(module, nn.Conv2d) and module is not self.out:
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")  # He et al. (2015)

    def forward(self, crops: Tensor) -> Tensor:
        """Return the logits."""
        seen, levels = torch.stack([crops == FREE, crops == BLOCKED], dim=1).float(), list[Tensor]()
        for block in self.down:
            levels.append(seen := block(seen))
        for narrow, conv, level in zip(self.narrow, self.up, levels[-2::-1]):
            seen = functional.relu(conv(level + functional.interpolate(narrow(seen), scale_factor=2.0)))
        return functional.pixel_shuffle(self.out(seen), 2)[:, 0]


class Completion:
    """Estimates the areas in view of candidates by a completed map; for `FrontierNavigator.estimate`."""

    def __init__(self, network: CompletionNetwork) -> None:
        """Take a trained network."""
        self._network = network.eval()

    @classmethod
    def load(cls, folder: Path) -> "Completion":
        """Read the network of a folder; CheckpointError if it is missing or damaged."""
        network = CompletionNetwork()
        try:
            network.load_state_dict(load_file(folder / COMPLETION_FILE))  # which are converted to float32
        except (OSError, RuntimeError, SafetensorError) as error:
            raise CheckpointError(
                f"{folder / COMPLETION_FILE} holds no network that completes maps: {error}"
            ) from error
        torch.set_num_threads(1)
        return cls(network)

    def save(self, folder: Path, about: Mapping[str, str]) -> None:
        """Write the network to a folder, with how it was made."""
        folder.mkdir(parents=True, exist_ok=True)
        weights = {name: value.half() for name, value in self._network.state_dict().items()}  # half the size
        save_file(weights, folder / COMPLETION_FILE, dict(about))

    def blocked(self, crops: np.ndarray) -> np.ndarray:
        """Return the chance that cells are blocked, float32, for crops, shape (n, SIDE, SIDE), uint8."""
        with torch.inference_mode():
            return torch.sigmoid(self._network(torch.from_numpy(crops))).numpy()

    def __call__(self, navigator: FrontierNavigator, table: np.ndarray) -> None:
        """Write the expected areas of candidates, shape (k,), `CANDIDATE`, into their field `visible` [m2]."""
        planning = navigator.map
        frame, crops = (*planning.origin, planning.side), np.empty((len(table), SIDE, SIDE), dtype=np.uint8)
        for k, (x, y) in enumerate(table["viewpoint"].tolist()):
            crop(planning.joined, frame, x, y, crops[k])
        blocked = self.blocked(crops)
        reach = int(planning.tables[0].view_reach * planning.side / CELL)
        for k in range(len(table)):
            table["visible"][k] = expected_area(crops[k], blocked[k], reach, CAUTION)
