"""The V-Net of Ma et al.: five levels, skips by addition."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from sdm.segmentation.networks.blocks import convolutions, double, halve

# Convolutions at each level, finest first.
DEPTHS = (1, 2, 3, 3, 3)


class VNetEncoder(nn.Module):
    """(B,1,x,y,z) to the features of five levels, finest first; x, y, z multiples of 16.

    F. Milletari et al., "V-Net", 3DV 2016, in the form of Ma et al., MIDL 2020: 3^3 kernels, batch normalisation and
    no residuals; 16 filters at the finest level.

    Args:
        filters: Channels of the finest level; each further one has twice as many.
        dropout: Probability with which a channel of the coarsest level is dropped in training.
        inputs: Channels of the image.
    """

    def __init__(self, filters: int = 16, *, dropout: float = 0.5, inputs: int = 1) -> None:
        super().__init__()
        self.channels = [filters * 2**level for level in range(len(DEPTHS))]
        self.downs = nn.ModuleList(halve(a, b) for a, b in pairwise(self.channels))
        self.levels = nn.ModuleList(
            convolutions([inputs if level == 0 else c] + [c] * DEPTHS[level]) for level, c in enumerate(self.channels)
        )
        self.dropout = nn.Dropout3d(dropout)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Features of every level, finest first."""
        features = [self.levels[0](image)]
        for down, level in zip(self.downs, self.levels[1:], strict=True):
            features.append(level(down(features[-1])))
        features[-1] = self.dropout(features[-1])
        return features


class VNetDecoder(nn.Module):
    """The features of five levels to those of the finest, (B,filters,x,y,z).

    Args:
        filters: As of the encoder.
        skips: Whether the encoder's features are added at each level. Without, all that comes out has gone through
            the coarsest level.
        dropout: Probability with which a channel of the result is dropped in training.
    """

    def __init__(self, filters: int = 16, *, skips: bool = True, dropout: float = 0.0) -> None:
        super().__init__()
        channels = [filters * 2**level for level in range(len(DEPTHS))][::-1]
        self.skips = skips
        self.channels = filters
        self.ups = nn.ModuleList(double(a, b) for a, b in pairwise(channels))
        depths = DEPTHS[-2::-1]
        self.levels = nn.ModuleList(convolutions([c] * (d + 1)) for c, d in zip(channels[1:], depths, strict=True))
        self.dropout = nn.Dropout3d(dropout)

    def forward(self, features: list[Tensor]) -> Tensor:
        """Features of the finest level."""
        value = features[-1]
        for up, level, skip in zip(self.ups, self.levels, features[-2::-1], strict=True):
            value = up(value)
            value = level(torch.add(value, skip) if self.skips else value)
        return self.dropout(value)
