"""Feature networks for observations, and a base class of policies."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import Distribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, FlattenExtractor
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor, nn
from torch.nn import functional

Tensors = dict[str, Tensor]
"""Batch of observations: tensors by name, shape (batch, ...) each."""
PATCH = 10
"""Side length of the square patches of a map image [pixels]."""
SECTORS = 40
"""Maximum number of angular sectors of an encoded scan."""
ROW_FEATURES = 16
"""Number of learned features per row of a two-dimensional observation."""


class ExplorerFeatures(BaseFeaturesExtractor):
    """Feature extractor for dictionary observations: one encoder per entry, then a joint layer.

    Encoders are a convolution over separate patches for map images, sector pooling for `scan`, and a linear layer for
    other vectors. All rows of a two-dimensional entry share an encoder.
    """

    def __init__(self, observation_space: spaces.Dict, features_dim: int = 128, channels: int = 16) -> None:
        super().__init__(observation_space, features_dim)
        shapes = {key: tuple(space.shape or ()) for key, space in observation_space.spaces.items()}
        for key, space in observation_space.spaces.items():
            if isinstance(space, spaces.Discrete | spaces.MultiDiscrete):
                shapes[key] = (int(spaces.flatdim(space)),)
        boxes = {key: space for key, space in observation_space.items() if isinstance(space, spaces.Box)}
        crops = [key for key, box in boxes.items() if len(box.shape) >= 3 and (box.high == 255).all()]
        crops.sort(reverse=True)
        first = [key for key in ("scan", "motion") if key in shapes and key not in crops]
        total, self._encoders = 0, dict[str, str]()
        for key in (*crops, *first, *(key for key in sorted(shapes) if key not in (*crops, *first))):
            encoder, width = _make_encoder(key, shapes[key], channels, is_crop=key in crops)
            name = key.replace(".", "_")
            self._encoders[key] = name = f"{name}_part" if hasattr(self, name) or name == "merge" else name
            self.add_module(name, encoder)
            total += width
        self.merge = nn.Sequential(nn.Linear(total, features_dim), nn.ReLU())

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        return self.merge(self.encode(observations))

    def encode(self, observations: Mapping[str, Tensor]) -> Tensor:
        encoders = ((observations[key], getattr(self, name)) for key, name in self._encoders.items())
        return torch.cat([encode(part if part.ndim > 1 else part[:, None]) for part, encode in encoders], dim=1)


class FlatFeatures(ExplorerFeatures):
    """Feature extractor for dictionary observations flattened to vectors."""

    def __init__(self, observation_space: spaces.Box, *, parts: spaces.Dict, **arguments: int) -> None:
        super().__init__(parts, **arguments)
        self._shapes = {key: tuple(space.shape or (1,)) for key, space in sorted(parts.spaces.items())}

    def forward(self, observations: Tensor) -> Tensor:  # type: ignore[override]
        pieces = observations.split([math.prod(shape) for shape in self._shapes.values()], dim=1)
        parts = zip(self._shapes.items(), pieces, strict=True)
        return super().forward({key: piece.reshape(-1, *shape) for (key, shape), piece in parts})


class JointPolicy(ActorCriticPolicy):
    """Base of PPO and A2C policies with one network for action distribution and state value."""

    kind: Callable[..., nn.Module]
    """Class of the network."""

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Space,
        lr_schedule: Schedule,
        *,
        network: Mapping[str, Any],
        **arguments: Any,
    ) -> None:
        """Build the network with the arguments `network`; `arguments` are those of the base class."""
        self._settings = network
        # The extractor is required by the base class, and has no weights.
        arguments["features_extractor_class"] = FlattenExtractor
        super().__init__(observation_space, action_space, lr_schedule, **arguments)

    def _build(self, lr_schedule: Schedule) -> None:
        self.network: Any = self.kind(self.observation_space, **self._settings)
        make: Any = self.optimizer_class
        self.optimizer = make(self.network.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    def judge(self, obs: Tensors) -> tuple[Distribution, Tensor]:
        """Return the action distribution for observations, and state values, shape (batch, 1), float32."""
        raise NotImplementedError

    def forward(self, obs: Tensors, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:  # type: ignore[override]
        distribution, values = self.judge(obs)
        actions = distribution.get_actions(deterministic)
        return actions, values, distribution.log_prob(actions)

    def evaluate_actions(self, obs: Tensors, actions: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:  # type: ignore[override]
        distribution, values = self.judge(obs)
        return values, distribution.log_prob(actions), distribution.entropy()

    def get_distribution(self, obs: Tensors) -> Distribution:  # type: ignore[override]
        return self.judge(obs)[0]

    def predict_values(self, obs: Tensors) -> Tensor:  # type: ignore[override]
        return self.judge(obs)[1]


def flat_space(parts: spaces.Dict) -> spaces.Box:
    """Return the space of dictionary observations flattened to vectors."""
    return spaces.Box(-np.inf, np.inf, (spaces.flatdim(parts),), np.float32)


def flatten(observations: Mapping[str, np.ndarray]) -> np.ndarray:
    """Flatten batched dictionary observations to shape (batch, n), float32, entries sorted by name."""
    rows = [part.reshape(len(part), -1).astype(np.float32) for _, part in sorted(observations.items())]
    return np.concatenate(rows, axis=1)


class ScanSectors(nn.Sequential):
    """Scan encoder: linear layer over nearest range and fraction of invalid beams in angular sectors."""

    def __init__(self, num_beams: int, width: int) -> None:
        beams_per_sector = math.ceil(num_beams / SECTORS)
        super().__init__(nn.Linear(2 * math.ceil(num_beams / beams_per_sector), width), nn.ReLU())
        self._beams_per_sector = beams_per_sector

    def forward(self, scan: Tensor) -> Tensor:
        """Return features, shape (batch, width).

        `scan`: ranges from 0 (invalid) to 1, shape (batch, num_beams), float32.
        """
        # Missing ranges (0) get a separate channel, distinct from near obstacles.
        scan = scan[:, None]  # required by ONNX pooling
        invalid = (scan == 0).float()
        nearness = (1.0 - scan) * (1.0 - invalid)
        nearest = functional.max_pool1d(nearness, self._beams_per_sector, ceil_mode=True)
        share = functional.avg_pool1d(invalid, self._beams_per_sector, ceil_mode=True)
        return super().forward(torch.cat([nearest, share], dim=2)[:, 0])


class MapPatches(nn.Conv2d):
    """Map encoder: convolution over separate patches of a map image."""

    def __init__(self, shape: tuple[int, ...], channels: int) -> None:
        super().__init__(shape[0], channels, PATCH, stride=PATCH)
        self._missing = -shape[2] % PATCH, -shape[1] % PATCH

    def forward(self, crop: Tensor) -> Tensor:
        """Return features, shape (batch, channels * patches), of map images with pixels from 0 to 255.

        Weights, not pixels, are divided by 255, which requires `normalize_images=False`.
        """
        if any(self._missing):
            crop = functional.pad(crop, (0, self._missing[0], 0, self._missing[1]))
        return functional.relu(self._conv_forward(crop, self.weight / 255.0, self.bias)).flatten(1)


class _Rows(nn.Sequential):
    def __init__(self, encoder: nn.Module, num_axes: int) -> None:
        super().__init__(encoder)
        self._num_axes = num_axes

    def forward(self, table: Tensor) -> Tensor:
        return super().forward(table.flatten(0, -self._num_axes - 1)).reshape(table.shape[0], -1)


def _make_encoder(key: str, shape: tuple[int, ...], channels: int, is_crop: bool) -> tuple[nn.Module, int]:
    num_axes = 3 if is_crop else 1
    rows, shape = shape[:-num_axes], shape[-num_axes:] or (1,)
    if is_crop:
        encoder: nn.Module = MapPatches(shape, channels)
        width = channels * math.ceil(shape[1] / PATCH) * math.ceil(shape[2] / PATCH)
    elif key == "scan":
        width = 64
        encoder = ScanSectors(shape[0], width)
    else:
        width = ROW_FEATURES if rows else 32 if key == "motion" else 64
        encoder = nn.Sequential(nn.Linear(shape[0], width), nn.ReLU())
    return (_Rows(encoder, num_axes), math.prod(rows) * width) if rows else (encoder, width)
