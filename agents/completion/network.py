"""Convolutional network that completes maps (U-Net, Ronneberger et al. 2015, with sums for concatenations)."""

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from .raster import FREE, OCCUPIED

WIDTHS = 24, 64, 128, 192
"""Channels of the layers with cells of 0.4, 0.8, 1.6 and 3.2 m."""


def _layer(inputs: int, outputs: int, *, stride: int = 1, dilation: int = 1, size: int = 3) -> nn.Sequential:
    padding = dilation * (size - 1) // 2
    convolution = nn.Conv2d(inputs, outputs, size, stride, padding, dilation, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class CompletionNetwork(nn.Module):
    """Predicts for each cell of a turned raster whether it belongs to the floor that the robot can explore.

    Fully convolutional: any height and width that are multiples of `raster.STRIDE`.
    """

    def __init__(self, widths: tuple[int, int, int, int] = WIDTHS) -> None:
        super().__init__()
        first, second, third, last = widths
        self.down = nn.ModuleList(
            [
                nn.Sequential(_layer(3, first, stride=2, size=4), _layer(first, first)),
                nn.Sequential(_layer(first, second, stride=2), _layer(second, second)),
                nn.Sequential(_layer(second, third, stride=2), _layer(third, third)),
                _layer(third, last, stride=2),
            ]
        )
        self.bottom = nn.Sequential(_layer(last, last, dilation=2), _layer(last, last, dilation=4))
        pairs = [(last, third), (third, second), (second, first)]
        self.narrow = nn.ModuleList([nn.Conv2d(inputs, outputs, 1) for inputs, outputs in pairs])
        self.up = nn.ModuleList([_layer(outputs, outputs) for _, outputs in pairs])
        self.head = nn.Conv2d(first, 4, 3, padding=1)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # faster on CPUs

    def forward(self, channels: Tensor) -> Tensor:
        """Return logits, shape (n, height, width), float32. `channels`: those of `channels_of`."""
        layers = []
        for down in self.down:
            channels = down(channels)
            layers.append(channels)
        *sides, deep = layers
        deep = deep + self.bottom(deep)
        for side, narrow, up in zip(reversed(sides), self.narrow, self.up, strict=True):
            deep = up(side + functional.interpolate(narrow(deep), scale_factor=2))
        return functional.pixel_shuffle(self.head(deep), 2)[:, 0]


def channels_of(codes: np.ndarray) -> Tensor:
    """Return free, occupied and unknown cells as channels, shape (n, 3, height, width), float32.

    `codes`: those of `TurnedRaster`, shape (n, height, width), uint8.
    """
    cells = torch.from_numpy(codes)
    return torch.stack([cells & FREE > 0, cells & OCCUPIED > 0, cells == 0], dim=-1).float().movedim(-1, 1)
