"""The 3D U-Net: four levels, skips by concatenation."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from sdm.segmentation.networks.blocks import convolutions

LEVELS = 4


class UNetEncoder(nn.Module):
    """(B,1,x,y,z) to the features of four levels, finest first; x, y, z multiples of 8.

    O. Cicek et al., "3D U-Net: learning dense volumetric segmentation from sparse annotation", MICCAI 2016: two
    convolutions a level, of which the second doubles the channels, and pooling; with padding, so that the output is as
    large as the input.

    Args:
        filters: Channels that the finest level gives; each further one gives twice as many. 64 in that paper.
        dropout: Probability with which a channel of the coarsest level is dropped in training (Juhl et al.: 0.05).
        inputs: Channels of the image.
    """

    def __init__(self, filters: int = 64, *, dropout: float = 0.05, inputs: int = 1) -> None:
        super().__init__()
        self.channels = [filters * 2**level for level in range(LEVELS)]
        self.levels = nn.ModuleList(
            convolutions([inputs if level == 0 else self.channels[level - 1], c // 2, c])
            for level, c in enumerate(self.channels)
        )
        self.dropout = nn.Dropout3d(dropout)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Features of every level, finest first."""
        features = [self.levels[0](image)]
        for level in self.levels[1:]:
            features.append(level(functional.max_pool3d(features[-1], 2)))
        features[-1] = self.dropout(features[-1])
        return features


class UNetDecoder(nn.Module):
    """The features of four levels to those of the finest, (B,filters,x,y,z).

    Args:
        filters: As of the encoder.
        skips: Whether the encoder's features are concatenated at each level.
        dropout: Probability with which a channel of the result is dropped in training.
    """

    def __init__(self, filters: int = 64, *, skips: bool = True, dropout: float = 0.0) -> None:
        super().__init__()
        channels = [filters * 2**level for level in range(LEVELS)][::-1]
        self.skips = skips
        self.channels = filters
        self.ups = nn.ModuleList(nn.ConvTranspose3d(c, c, 2, stride=2) for c in channels[:-1])
        self.levels = nn.ModuleList(
            convolutions([before + after if skips else before, after, after]) for before, after in pairwise(channels)
        )
        self.dropout = nn.Dropout3d(dropout)

    def forward(self, features: list[Tensor]) -> Tensor:
        """Features of the finest level."""
        value = features[-1]
        for up, level, skip in zip(self.ups, self.levels, features[-2::-1], strict=True):
            value = up(value)
            value = level(torch.cat([skip, value], 1) if self.skips else value)
        return self.dropout(value)
