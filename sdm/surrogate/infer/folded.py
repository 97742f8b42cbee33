"""SDMNN+ by plain torch on a CPU, its operations laid out for one map at a time.

The maps are those of `SDMNNPlus.forward` up to rounding. What differs is what is worked out, and where:

- The modes lie in the order of the coarse map's voxels, and the mean map's share of every later sum, which no parameter
  changes, is there from the beginning: only the difference from the mean map goes through the network.
- The trained interpolation is trilinear interpolation, three small matrix products, and what training added, a
  convolution of small weights that bfloat16 holds. It shares its input, and one convolution, with the first of the
  refinement.
- The gains of the modulation are multiplied into the weights, which are fewer than the feature maps' values.
- Channels are side by side in memory, as oneDNN wants them, and the voxels of a block that lie along z are moved as one
  number when blocks become a map.
- In bfloat16, modes that are 8-bit numbers with a scale each, as in files of weights, stay so: a fourth of what has to
  be read for a map.
"""

from __future__ import annotations

import copy
from typing import cast

import torch
from torch import Tensor, nn

from sdm.runtime.threads import threads
from sdm.surrogate.infer.weights_file import FINE_ROWS, WHOLE
from sdm.surrogate.networks.sdmnn_plus import COARSE, FINE, LEAK, SDMNNPlus, interpolation_matrix, trilinear
from sdm.surrogate.networks.voxel_shuffle import merge

# Types as wide as the two coarse values, and the four voxels, of a block that are side by side along z.
PAIRS = {torch.float32: torch.int64, torch.bfloat16: torch.int32}
FOURS = {torch.float32: torch.complex128, torch.bfloat16: torch.int64}
# Rows of the 8-bit modes are filled up to a multiple of this: torch's kernel reads whole vectors.
ROWS = 64
# Modes are 8-bit numbers where these, times the scale, are no further from them than this share of the scale.
LARGEST_ROUNDING = 1e-3
# Largest error of the maps by 8-bit modes, as a share of their largest value: bfloat16 rounds by 0.004.
LARGEST_ERROR = 0.01


class FoldedNetwork:
    """A function from theta (B,4) to maps (B,1,80,64,40) [mm], float32 on the host, without gradients.

    Args:
        model: The network on the host; later changes of its weights have no effect.
        dtype: torch.bfloat16: the corrections of the interpolated coarse map, and the coarse map's smaller modes, in
            bfloat16. torch.float32: all in float32.
    """

    @torch.no_grad()
    def __init__(self, model: SDMNNPlus, dtype: torch.dtype) -> None:
        model = copy.deepcopy(model)
        self.dtype, self.blocks, self.channels = dtype, model.blocks, int(model.config["channels"])
        self.count = self.blocks[0] * self.blocks[1] * self.blocks[2]
        self._state = nn.Sequential(model.features, model.trunk).eval()
        self._gains = model.film
        self._coefficients, self._scale = model.coefficients, model.scale
        self._modes = _Modes(_merged(model.modes, model), dtype)
        mean = _padded(model.mean.reshape(1, COARSE**3, *self.blocks))
        # (80,64 x 40): what the mean map and the biases give, whatever theta is.
        last = model.last.bias.reshape(1, -1, 1, 1, 1)  # pyright: ignore[reportOptionalMemberAccess]
        self._constant = merge(model.interpolate(mean) + last, FINE).reshape(FINE * self.blocks[0], -1).clone()
        self._place = _rows(model.first(mean) + model.place).to(dtype)
        self._lines = [interpolation_matrix(count) for count in self.blocks]
        self._first = _beside(model.first.weight)
        added = model.interpolate.weight - trilinear()
        self._around = _beside(torch.cat([model.first.weight, added]).to(dtype))
        self._no_bias = torch.zeros(len(self._around), dtype=dtype)
        middle = cast("list[nn.Conv3d]", list(model.middle))
        self._middle = [(_beside(layer.weight), cast("Tensor", layer.bias)) for layer in middle]
        self._last = model.last.weight.reshape(FINE**3, self.channels).t().to(dtype).contiguous()

    @torch.inference_mode()
    def __call__(self, theta: Tensor) -> Tensor:
        """Maps (B,1,80,64,40) [mm] of theta (B,4)."""
        # A second thread takes a twentieth off bfloat16's time where both cores are free. Where they are not, threads
        # that wait for each other by spinning take many times as long.
        with threads(1 if self.dtype == torch.bfloat16 else torch.get_num_threads()):
            return self._maps(theta)

    def _maps(self, theta: Tensor) -> Tensor:
        maps = torch.empty(len(theta), 1, *(FINE * count for count in self.blocks))
        state = self._state(theta)
        coefficients = self._coefficients(state) * self._scale
        gains = self._gains(state).reshape(len(theta), len(self._middle) + 1, 2, self.channels)
        for number, target in enumerate(maps):
            coarse = self._modes(coefficients[number : number + 1])
            self._map(coarse, gains[number], target.view(FINE * self.blocks[0], -1))
        return maps

    def _map(self, coarse: Tensor, gains: Tensor, target: Tensor) -> None:
        """One map (80,64 x 40) of the coarse map's difference from the mean map (1,25600), and of gains (D,2,C)."""
        nx, ny, nz = self.blocks
        pairs = coarse.to(self.dtype).view(PAIRS[self.dtype]).view(nx, COARSE, ny, COARSE, nz)
        blocks = pairs.permute(0, 2, 4, 1, 3).contiguous().view(self.dtype)
        around = _padded(blocks.view(1, nx, ny, nz, -1).permute(0, 4, 1, 2, 3))
        x, added = self._begin(around, gains[0])
        for (weight, bias), (gain, shift) in zip(self._middle, gains[1:], strict=True):
            by = 1 + gain
            grid = x.view(1, nx, ny, nz, -1).permute(0, 4, 1, 2, 3)
            found = _convolved(grid, _scaled(weight, by).to(self.dtype), torch.addcmul(shift, bias, by), 1)
            x = nn.functional.leaky_relu_(found, LEAK).add_(x)
        corrections = torch.addmm(added, x, self._last)
        fours = corrections.view(FOURS[self.dtype]).view(nx, ny, nz, FINE, FINE)
        by_x, by_y, by_z = self._lines
        lines = torch.matmul(by_y, (coarse.view(-1, COARSE * nz) @ by_z.t()).view(COARSE * nx, COARSE * ny, -1))
        torch.addmm(self._constant, by_x, lines.view(COARSE * nx, -1), out=target)
        target += fours.permute(0, 3, 1, 4, 2).contiguous().view(self.dtype).view_as(target)

    def _begin(self, around: Tensor, gains: Tensor) -> tuple[Tensor, Tensor]:
        """The first feature maps (3200,C), and what training added to the interpolation (3200,64)."""
        by, count = 1 + gains[0], self.channels
        weight, bias = self._around.clone(memory_format=torch.preserve_format), self._no_bias.clone()
        weight[:count], bias[:count] = _scaled(self._first, by), gains[1]
        found = _convolved(around, weight, bias, 0)
        x = torch.addcmul(found[:, :count], self._place, by.to(self.dtype))
        return nn.functional.leaky_relu_(x, LEAK), found[:, count:]


class _Modes:
    """Coarse maps (1,25600) of coefficients (1,modes), less the mean map."""

    def __init__(self, modes: Tensor, dtype: torch.dtype) -> None:
        self._large, self._small = modes.contiguous(), None
        rest = modes[FINE_ROWS:]
        self._product = getattr(torch, "_weight_int8pack_mm", None)
        if dtype != torch.bfloat16 or not len(rest) or self._product is None:
            return
        scale = rest.abs().amax(1).clamp_min(1e-12) / WHOLE
        whole = (rest / scale[:, None]).round_().to(torch.int8)
        rounded = torch.addcmul(rest, whole, scale[:, None], value=-1).abs_().amax(1)
        if bool((rounded > scale * LARGEST_ROUNDING).any()):
            return
        rows = -(-len(rest) // ROWS) * ROWS
        packed = nn.functional.pad(whole.t(), (0, rows - len(rest))).contiguous()
        self._scale = nn.functional.pad(scale, (0, rows - len(rest)))
        self._small = packed, torch.ones(len(packed), dtype=dtype)
        # It is no documented part of torch, so that it has to show that it works.
        sample = torch.cos(torch.arange(len(modes), dtype=torch.float32))[None]
        exact = sample @ modes
        self._large = modes[:FINE_ROWS].contiguous()
        if not (self(sample) - exact).abs().max() <= LARGEST_ERROR * exact.abs().max():
            self._large, self._small = modes.contiguous(), None

    def __call__(self, coefficients: Tensor) -> Tensor:
        if self._small is None or self._product is None:
            return coefficients @ self._large
        rest = coefficients[:, FINE_ROWS:]
        filled = nn.functional.pad(rest, (0, len(self._scale) - rest.shape[1])) * self._scale
        small = self._product(filled.bfloat16(), *self._small)
        return (coefficients[:, :FINE_ROWS] @ self._large).add_(small)


def _merged(modes: Tensor, model: SDMNNPlus) -> Tensor:
    """Modes (N,25600) by blocks, in the order of the coarse map's voxels."""
    return merge(modes.detach().reshape(-1, COARSE**3, *model.blocks), COARSE).flatten(1)


def _padded(maps: Tensor) -> Tensor:
    """With a block more at each side, as the border's."""
    return nn.functional.pad(maps, (1,) * 6, mode="replicate")


def _beside(weight: Tensor) -> Tensor:
    """The weights of a convolution with channels side by side."""
    return weight.detach().clone().contiguous(memory_format=torch.channels_last_3d)


def _scaled(weight: Tensor, gains: Tensor) -> Tensor:
    return weight * gains.view(-1, 1, 1, 1, 1)


def _rows(maps: Tensor) -> Tensor:
    """Maps (1,C,x,y,z) as (x y z, C)."""
    return maps[0].flatten(1).t().contiguous()


def _convolved(maps: Tensor, weight: Tensor, bias: Tensor, padding: int) -> Tensor:
    """The convolution of maps (1,C,x,y,z) with channels side by side, as (x y z, C)."""
    bias = bias.to(weight.dtype)
    if weight.dtype == torch.float32 and torch.backends.mkldnn.is_available():
        # On one thread torch takes a way of its own for float32, of three times the time.
        found = torch.mkldnn_convolution(maps, weight, bias, [padding] * 3, [1] * 3, [1] * 3, 1)
    else:
        found = torch.conv3d(maps, weight, bias, padding=padding)
    return found.permute(0, 2, 3, 4, 1).reshape(-1, len(weight))
