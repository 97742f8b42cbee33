"""The surrogate of Wang et al., MIDL 2020: an encoder-decoder network with merged layers."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from sdm.core.given_values import whole
from sdm.errors import SDMError
from sdm.surrogate.networks.cochlea_grid import GRID
from sdm.surrogate.networks.theta_features import ThetaFeatures
from sdm.training.precision import full_precision


class SDMNN(nn.Module):
    """Parameters (B,4) = (a, alpha, b, phi) to maps (B,1,80,64,40) [mm], negative inside, by an encoder-decoder.

    Args:
        channels: Feature maps at the finest level; they double at each of two halvings. 2, 3, 4, 6, 12 or a multiple of
            8, so that each level's are normalised in groups of the same size.

    Raises:
        SDMError: Another number of channels.

    The paper says "encoder-decoder with merged layers inspired by U-Net", trained by mean squared errors on 625 static
    maps and random ones made online; its sizes are not published. Here a linear layer makes a volume at half the
    resolution from the four parameters, a U-Net with concatenated skip layers works on it, and a transposed
    convolution brings it to the full grid.
    """

    def __init__(self, channels: int = 16) -> None:
        super().__init__()
        least = whole(channels, 2) or 0
        widths = [least, 2 * least, 4 * least]
        if not least or any(width % _groups(width) for width in widths):
            raise SDMError(f"sdmnn has 2, 3, 4, 6, 12 or a multiple of 8 channels, not {channels!r}")
        self.config = {"channels": channels}
        self.coarse = tuple(n // 2 for n in GRID.shape)
        self.features = ThetaFeatures()
        self.seed = nn.Linear(4, self.coarse[0] * self.coarse[1] * self.coarse[2])
        self.down = nn.ModuleList([_block(i, o) for i, o in zip([1, *widths[:-1]], widths, strict=True)])
        self.up = nn.ModuleList([nn.ConvTranspose3d(2 * w, w, 2, stride=2) for w in reversed(widths[:-1])])
        self.merge = nn.ModuleList([_block(2 * w, w) for w in reversed(widths[:-1])])
        self.full = nn.ConvTranspose3d(channels, channels // 2, 2, stride=2)
        self.last = nn.Conv3d(channels // 2, 1, 3, padding=1)

    def forward(self, theta: Tensor) -> Tensor:
        """Maps (B,1,80,64,40) [mm] of theta (B,4)."""
        x = self.seed(self.features.unit(theta)).reshape(-1, 1, *self.coarse)
        skips = []
        for level, block in enumerate(self.down):
            x = block(x if level == 0 else nn.functional.max_pool3d(x, 2))
            skips.append(x)
        for up, merge, skip in zip(self.up, self.merge, reversed(skips[:-1]), strict=True):
            x = merge(torch.cat([up(x), skip], 1))
        x = nn.functional.silu(self.full(x))
        with full_precision(theta):
            return self.last(x.to(self.last.weight.dtype))


def _block(inside: int, outside: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(inside, outside, 3, padding=1),
        nn.GroupNorm(_groups(outside), outside),
        nn.SiLU(),
        nn.Conv3d(outside, outside, 3, padding=1),
        nn.GroupNorm(_groups(outside), outside),
        nn.SiLU(),
    )


def _groups(width: int) -> int:
    """In how many groups so many feature maps are normalised."""
    return min(8, width // 2)
