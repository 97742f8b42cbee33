"""A network of SDMNN's size, for timing alone: parameters to a map."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

CHANNELS = (256, 128, 64, 32, 16)


class Decoder(nn.Module):
    """Parameters (B,P) to maps (B,1,n,n,n): a linear layer to n / 16 voxels, then four times: up, two convolutions.

    Channels come last in memory, which is how a GPU's bfloat16 convolutions want them.
    """

    def __init__(self, width: int, resolution: int) -> None:
        super().__init__()
        self.coarse = resolution // 16
        self.first = nn.Linear(width, CHANNELS[0] * self.coarse**3)
        layers: list[nn.Module] = []
        for wide, narrow in pairwise(CHANNELS):
            layers += [nn.ConvTranspose3d(wide, narrow, 2, 2), nn.ReLU()]
            for _ in range(2):
                layers += [nn.Conv3d(narrow, narrow, 3, padding=1), nn.ReLU()]
        self.up = nn.Sequential(*layers, nn.Conv3d(CHANNELS[-1], 1, 1))
        self.up.to(memory_format=torch.channels_last_3d)  # pyright: ignore[reportCallIssue]

    def forward(self, theta: Tensor) -> Tensor:
        coarse = self.first(theta).reshape(-1, CHANNELS[0], *(self.coarse,) * 3)
        return self.up(coarse.contiguous(memory_format=torch.channels_last_3d))
