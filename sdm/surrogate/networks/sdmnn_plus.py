"""SDMNN+: a low-rank map at 0.4 mm, refined to 0.2 mm by a shallow network. Made for CPUs."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn

from sdm.surrogate.networks.cochlea_grid import GRID
from sdm.surrogate.networks.theta_features import ThetaFeatures
from sdm.surrogate.networks.voxel_shuffle import merge, split
from sdm.training.precision import full_precision
from sdm.training.training_settings import check_counts

# Voxels of the grid along each edge of a block, and of the coarse map.
FINE, COARSE = 4, 2
# Slope below zero of the refinement's activation: on a CPU an exponential costs as much as a convolution here.
LEAK = 0.1


class SDMNNPlus(nn.Module):
    """Parameters (B,4) = (a, alpha, b, phi) to maps (B,1,80,64,40) [mm], negative inside.

    Args:
        modes: Modes of the coarse map.
        hidden: Width of the network that gives their coefficients.
        channels: Feature maps of the refinement.
        depth: Convolutions of the refinement, besides the first and the last.
        pointwise: Features of single blocks, made of what the last of these gives. The last layer then takes the
            outputs of all others side by side and has no bias, and the interpolation stays as it begins. 0: the first
            kind of this network, whose refinement adds up what its convolutions give.

    1. Features of theta (`ThetaFeatures`) and a small network give coefficients of `modes` modes.
    2. The modes, one matrix product, give the map at 0.4 mm. They begin as the maps' proper orthogonal decomposition.
    3. A few convolutions over blocks of 0.8 mm, modulated by theta (FiLM: Perez et al., AAAI 2018), turn the coarse
       values in and around each block into its 4 x 4 x 4 voxels (a sub-voxel head: Shi et al., CVPR 2016). They begin
       as trilinear interpolation.

    So the many voxels of the full grid are touched only once, at the end.
    """

    scale: Tensor
    fixed: Tensor
    by_x: Tensor
    by_y: Tensor
    by_z: Tensor

    def __init__(
        self, modes: int = 208, hidden: int = 256, channels: int = 48, depth: int = 1, pointwise: int = 0
    ) -> None:
        super().__init__()
        check_counts(modes=modes, hidden=hidden, channels=channels)
        check_counts(0, depth=depth, pointwise=pointwise)
        self.config = {"modes": modes, "hidden": hidden, "channels": channels, "depth": depth}
        if pointwise:
            self.config["pointwise"] = pointwise
        self.blocks = tuple(n // FINE for n in GRID.shape)
        count = self.blocks[0] * self.blocks[1] * self.blocks[2]
        self.features = ThetaFeatures()
        self.trunk = nn.Sequential(
            nn.Linear(ThetaFeatures.width, hidden), nn.SiLU(), _Residual(hidden), _Residual(hidden)
        )
        self.coefficients = nn.Linear(hidden, modes)
        # Standard deviations of the coefficients [mm], so that the network's outputs are of order one. Modes have a
        # mean square of 1, so that a coefficient is its share of a voxel's distance.
        self.register_buffer("scale", torch.full((modes,), modes**-0.5))
        self.modes = nn.Parameter(torch.randn(modes, COARSE**3 * count))
        self.mean = nn.Parameter(torch.zeros(COARSE**3 * count))
        self.film = nn.Linear(hidden, 2 * channels * (depth + 1))
        self.place = nn.Parameter(torch.zeros(1, channels, *self.blocks))
        self.interpolate = None if pointwise else nn.Conv3d(COARSE**3, FINE**3, 3)
        self.first = nn.Conv3d(COARSE**3, channels, 3)
        self.middle = nn.ModuleList([nn.Conv3d(channels, channels, 3, padding=1) for _ in range(depth)])
        self.pointwise = nn.Conv3d(channels, pointwise, 1, bias=False) if pointwise else None
        self.last = nn.Conv3d(
            channels * (depth + 1) + pointwise if pointwise else channels, FINE**3, 1, bias=not pointwise
        )
        for zero in (self.last.weight, self.last.bias, self.film.weight, self.film.bias):
            if zero is not None:
                nn.init.zeros_(zero)
        if self.interpolate is not None:
            nn.init.zeros_(cast("Tensor", self.interpolate.bias))
            with torch.no_grad():
                self.interpolate.weight.copy_(trilinear())
        # Not part of the state: trilinear interpolation, as weights of `interpolate` and along each axis.
        self.register_buffer("fixed", trilinear(), persistent=False)
        for axis, blocks in zip("xyz", self.blocks, strict=True):
            self.register_buffer(f"by_{axis}", interpolation_matrix(blocks), persistent=False)

    def forward(self, theta: Tensor) -> Tensor:
        """Maps (B,1,80,64,40) [mm] of theta (B,4)."""
        return self.refined(*self.interpolated(theta))

    def both(self, theta: Tensor) -> tuple[Tensor, Tensor]:
        """The coarse maps as `low_rank` gives them, and the maps of `forward` up to rounding, laid out for training.

        The trilinear part of the interpolation is three products in float32. What training added to it, if it is
        trained, is small enough for bfloat16, and one convolution with `first`, whose input it shares.
        """
        with full_precision(theta):
            state, coarse = self._begin(theta)
            plain, gains = self._trilinear(merge(coarse, COARSE)), self._gains(state)
        if self.interpolate is None:
            corrections = self._corrections(self.first(_padded(coarse)), gains)
            return coarse, plain + merge(corrections, FINE).to(plain.dtype)
        weight = torch.cat([self.first.weight, self.interpolate.weight - self.fixed])
        bias = torch.cat([cast("Tensor", self.first.bias), cast("Tensor", self.interpolate.bias)])
        found = nn.functional.conv3d(_padded(coarse), weight, bias)
        begun, added = found.split([len(self.first.weight), FINE**3], 1)
        corrections = added + self._corrections(begun, gains)
        return coarse, plain + merge(corrections, FINE).to(plain.dtype)

    def interpolated(self, theta: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Input of `refined` for theta (B,4): the part that needs float32.

        Returns:
            The coarse maps (B,8,22,18,12) [mm] with their borders repeated, the refinement's gains (B,depth+1,2,C,1),
            and the maps (B,64,20,16,10) [mm] in blocks, interpolated.
        """
        with full_precision(theta):
            state, coarse = self._begin(theta)
            around = _padded(coarse)
            return around, self._gains(state), self.interpolated_blocks(around)

    def refined(self, around: Tensor, gains: Tensor, plain: Tensor) -> Tensor:
        """Maps (B,1,80,64,40) [mm] of what `interpolated` gave: small corrections, for which bfloat16 is enough."""
        return merge(plain + self._corrections(self.first(around), gains).to(plain.dtype), FINE)

    def interpolated_blocks(self, around: Tensor) -> Tensor:
        """Maps (B,64,20,16,10) [mm] in blocks of coarse ones (B,8,22,18,12) with their borders repeated."""
        return nn.functional.conv3d(around, self.fixed) if self.interpolate is None else self.interpolate(around)

    def _gains(self, state: Tensor) -> Tensor:
        return self.film(state).reshape(state.shape[0], len(self.middle) + 1, 2, -1, 1)

    def _corrections(self, begun: Tensor, gains: Tensor) -> Tensor:
        """In blocks, of the first convolution's output."""
        x = _modulated(begun + self.place, gains[:, 0])
        kept = [x]
        for number, layer in enumerate(self.middle, 1):
            new = _modulated(layer(x), gains[:, number])
            x = x + new if self.pointwise is None else new
            kept.append(x)
        if self.pointwise is None:
            return self.last(x)
        return self.last(torch.cat([*kept, nn.functional.leaky_relu(self.pointwise(x), LEAK)], 1))

    def _trilinear(self, coarse: Tensor) -> Tensor:
        """Maps (B,1,80,64,40) of coarse maps (B,1,40,32,20), interpolated."""
        by_x, by_y, by_z = self.by_x, self.by_y, self.by_z
        lines = torch.matmul(by_y, coarse[:, 0] @ by_z.t())
        return (by_x @ lines.flatten(2)).unflatten(2, lines.shape[2:])[:, None]

    def coarse(self, theta: Tensor) -> Tensor:
        """Maps (B,1,40,32,20) [mm] of theta (B,4) on `COARSE_GRID`, before they are refined: a tenth of the work.

        For a first look: the refinement may take back a tenth of a millimetre of it.
        """
        with full_precision(theta):
            return merge(self._begin(theta)[1], COARSE)

    def _begin(self, theta: Tensor) -> tuple[Tensor, Tensor]:
        """Output of the trunk for theta, and the coarse maps in blocks."""
        state = self.trunk(self.features(theta))
        return state, self.low_rank(self.coefficients(state) * self.scale)

    def low_rank(self, coefficients: Tensor) -> Tensor:
        """Coarse maps (B,8,20,16,10) [mm] in blocks, of coefficients (B,modes) [mm]."""
        return torch.addmm(self.mean, coefficients, self.modes).reshape(-1, COARSE**3, *self.blocks)

    def coarse_of(self, maps: Tensor) -> Tensor:
        """Target of `low_rank` for exact maps (B,1,80,64,40): (B,25600) [mm]."""
        return split(nn.functional.avg_pool3d(maps, FINE // COARSE), COARSE).flatten(1)


def _modulated(x: Tensor, gains: Tensor) -> Tensor:
    """Maps x (B,C,...) scaled and shifted by gains (B,2,C,1), channel by channel, and then bent."""
    # Flat: CPU runtimes work along the last axis, which has ten blocks only.
    flat = x.flatten(2) * (1 + gains[:, 0]) + gains[:, 1]
    return nn.functional.leaky_relu(flat, LEAK).reshape(x.shape)


def _padded(coarse: Tensor) -> Tensor:
    """Maps in blocks with a block more at each side, as the border's."""
    return nn.functional.pad(coarse, (1,) * 6, mode="replicate")


class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.layers(x)


def interpolation_line() -> Tensor:
    """(4,6) weights along one axis: of the coarse values of a block and its two neighbours for its voxels."""
    line = torch.zeros(FINE, 3 * COARSE)
    for voxel in range(FINE):
        at = (voxel + 0.5) / (FINE // COARSE) - 0.5 + COARSE
        low = int(at)
        line[voxel, low], line[voxel, low + 1] = 1 - (at - low), at - low
    return line


def interpolation_matrix(blocks: int) -> Tensor:
    """(4 blocks, 2 blocks): interpolation along an axis, the blocks at both ends repeated."""
    line, matrix = interpolation_line(), torch.zeros(FINE * blocks, COARSE * blocks)
    for block in range(blocks):
        for column in range(3 * COARSE):
            source = min(max(block - 1 + column // COARSE, 0), blocks - 1)
            matrix[FINE * block : FINE * (block + 1), COARSE * source + column % COARSE] += line[:, column]
    return matrix


def trilinear() -> Tensor:
    """(64,8,3,3,3) weights of `interpolate` that are trilinear interpolation.

    Coarse values are at the middles of 2^3 voxels.
    """
    line = interpolation_line().reshape(FINE, 3, COARSE)
    weights = torch.einsum("aip,bjq,ckr->abcpqrijk", line, line, line)
    return weights.reshape(FINE**3, COARSE**3, 3, 3, 3)
