"""The network that turns an exploration observation into features."""

import math

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn
from torch.nn import functional

PATCH = 10
"""Side of a map patch [pixels]; patches do not overlap, so that every pixel is read once."""
SECTORS = 40
"""Number of angles into which the scan is pooled; fewer for a lidar with fewer beams."""
NEEDED = ("scan", "motion")
"""Observations that every network reads."""


class ExplorerFeatures(BaseFeaturesExtractor):
    """A patch convolution on each map crop, sector pooling on the scan, a small layer on each other vector.

    Reads `scan` and `motion`, and whatever else there is: parts with three axes are map crops, those with one are
    vectors. A convolution whose stride equals its kernel costs a fraction of an overlapping one, and where a wall lies
    within a patch matters less than that it does.
    """

    def __init__(self, observation_space: spaces.Dict, features_dim: int = 128, channels: int = 16) -> None:
        """Build the layers for an observation space, with features of a width and convolutions of some channels.

        Raises:
            ValueError: if `scan` or `motion` is missing, crops cannot be cut into patches, or a part is neither a crop
                nor a vector.
        """
        super().__init__(observation_space, features_dim)
        if missing := [key for key in NEEDED if key not in observation_space.spaces]:
            raise ValueError(
                f"the network reads the observations {list(NEEDED)}, but the observation space lacks {missing}; "
                f"it has {sorted(observation_space.spaces)}"
            )
        shapes = {key: tuple(space.shape or ()) for key, space in observation_space.spaces.items()}
        if unfit := [f"{key} {shape}" for key, shape in shapes.items() if len(shape) not in (1, 3)]:
            raise ValueError(f"the network reads vectors and map crops, and neither are {unfit}")
        self.crops = [key for key in sorted(shapes, reverse=True) if len(shapes[key]) == 3]  # the nearer one first
        self.vectors = [key for key in sorted(shapes) if len(shapes[key]) == 1 and key not in NEEDED]
        for key in self.crops:
            self.add_module(key, MapPatches(shapes[key], channels))
        num_beams = shapes["scan"][0]
        beams_per_sector = math.ceil(num_beams / SECTORS)
        self.nearest = nn.MaxPool1d(beams_per_sector, ceil_mode=True)
        self.share = nn.AvgPool1d(beams_per_sector, ceil_mode=True)
        self.scan = nn.Sequential(nn.Linear(2 * math.ceil(num_beams / beams_per_sector), 64), nn.ReLU())
        self.motion = nn.Sequential(nn.Linear(shapes["motion"][0], 32), nn.ReLU())
        for key in self.vectors:
            self.add_module(key, nn.Sequential(nn.Linear(shapes[key][0], 64), nn.ReLU()))
        with torch.no_grad():
            sample = {key: torch.zeros(1, *shape) for key, shape in shapes.items()}
            width = self._encode(sample).shape[1]
        self.merge = nn.Sequential(nn.Linear(width, features_dim), nn.ReLU())

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Return the features, shape (batch, features_dim)."""
        return self.merge(self._encode(observations))

    def _encode(self, observations: dict[str, Tensor]) -> Tensor:
        """Return all parts side by side, shape (batch, width)."""
        scan = observations["scan"]
        # 0 stands for "no measurement", which must not pass for "very near": it gets a channel of its own.
        invalid = (scan == 0).float()
        nearness = (1.0 - scan) * (1.0 - invalid)
        parts = [self.get_submodule(key)(observations[key]) for key in self.crops]
        parts.append(self.scan(torch.cat([self.nearest(nearness), self.share(invalid)], dim=1)))
        parts += [self.get_submodule(key)(observations[key]) for key in ("motion", *self.vectors)]
        return torch.cat(parts, dim=1)


class MapPatches(nn.Conv2d):
    """Features of the patches of a map crop."""

    def __init__(self, shape: tuple[int, ...], channels: int) -> None:
        if len(shape) != 3 or shape[1] % PATCH or shape[2] % PATCH:
            raise ValueError(f"map crops must have shape (channels, n {PATCH}, m {PATCH}), got {shape}")
        super().__init__(shape[0], channels, PATCH, stride=PATCH)

    def forward(self, crop: Tensor) -> Tensor:
        """Return the features, shape (batch, channels * patches), of crops from 0 to 255.

        The weights are scaled rather than the pixels, of which there are many more; so the policy must not
        scale images itself (`normalize_images=False`).
        """
        return functional.relu(self._conv_forward(crop, self.weight / 255.0, self.bias)).flatten(1)
