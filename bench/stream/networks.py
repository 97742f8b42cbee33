"""Networks of SDMNN's kind, for timing alone: parameters (B,P) to maps (B,1,n,n,n), n a multiple of 16.

Wang et al., MIDL 2020, say "encoder-decoder with merged layers inspired by U-Net" and no sizes. `UNet` is the plain
reading of that at the map's own resolution; `Decoder` is the lighter half of it. Channels come last in memory, which
is how a GPU's bfloat16 convolutions want them.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn


class Decoder(nn.Module):
    """A linear layer to n / 16 voxels, then four times: up, two convolutions."""

    CHANNELS = (256, 128, 64, 32, 16)

    def __init__(self, width: int, resolution: int) -> None:
        super().__init__()
        self.coarse = resolution // 16
        self.first = nn.Linear(width, self.CHANNELS[0] * self.coarse**3)
        layers: list[nn.Module] = []
        for wide, narrow in pairwise(self.CHANNELS):
            layers += [nn.ConvTranspose3d(wide, narrow, 2, 2), nn.ReLU()]
            for _ in range(2):
                layers += [nn.Conv3d(narrow, narrow, 3, padding=1), nn.ReLU()]
        self.up = nn.Sequential(*layers, nn.Conv3d(self.CHANNELS[-1], 1, 1))
        self.up.to(memory_format=torch.channels_last_3d)  # pyright: ignore[reportCallIssue]

    def forward(self, theta: Tensor) -> Tensor:
        coarse = self.first(theta).reshape(-1, self.CHANNELS[0], *(self.coarse,) * 3)
        return self.up(coarse.contiguous(memory_format=torch.channels_last_3d))


class UNet(nn.Module):
    """A 3D U-Net (Cicek et al., MICCAI 2016) of half its channels on a volume that a linear layer makes."""

    CHANNELS = (16, 32, 64, 128)

    def __init__(self, width: int, resolution: int) -> None:
        super().__init__()
        self.seed = nn.Linear(width, (resolution // 4) ** 3)
        self.coarse, self.full = resolution // 4, resolution
        self.down = nn.ModuleList(_block(i, o) for i, o in pairwise((1, *self.CHANNELS)))
        steps = list(pairwise(reversed(self.CHANNELS)))
        self.up = nn.ModuleList(nn.ConvTranspose3d(wide, narrow, 2, 2) for wide, narrow in steps)
        self.merge = nn.ModuleList(_block(2 * narrow, narrow) for _, narrow in steps)
        self.last = nn.Conv3d(self.CHANNELS[0], 1, 1)
        self.to(memory_format=torch.channels_last_3d)  # pyright: ignore[reportCallIssue]

    def forward(self, theta: Tensor) -> Tensor:
        x = self.seed(theta).reshape(-1, 1, *(self.coarse,) * 3)
        x = nn.functional.interpolate(x, size=(self.full,) * 3)
        skips: list[Tensor] = []
        for block in self.down:
            x = block(nn.functional.max_pool3d(x, 2) if skips else x)
            skips.append(x)
        for up, merge, skip in zip(self.up, self.merge, reversed(skips[:-1]), strict=True):
            x = merge(torch.cat([up(x), skip], 1))
        return self.last(x)


NETWORKS: dict[str, type[nn.Module]] = {"decoder": Decoder, "u-net": UNet}


def _block(inside: int, outside: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before in (inside, outside):
        layers += [nn.Conv3d(before, outside, 3, padding=1, bias=False), nn.BatchNorm3d(outside), nn.ReLU()]
    return nn.Sequential(*layers)
