"""SDMNN+ by plain torch on a CPU, its operations laid out for one map at a time.

The maps are those of `SDMNNPlus.forward` up to rounding. What differs is what is worked out, and where:

- The modes lie in the order of the coarse map's voxels, and the mean map's share of every later sum, which no parameter
  changes, is there from the beginning: only the difference from the mean map goes through the network.
- The interpolation is trilinear, products along z and y and sums of neighbours along x. What training added to it, if
  it is trained, is a convolution of small weights that bfloat16 holds, one with the first of the refinement.
- The gains of the modulation are multiplied into the weights, which are fewer than the feature maps' values.
- Channels are side by side in memory, as oneDNN wants them, and blocks in the order x, z, y: there are 16 along y, as
  many as an AMX tile has rows. Voxels of a block that lie along z are moved as one number when blocks become a map.
- Layers of a single theta are products of a matrix and a vector, its features Python's own numbers: there torch takes
  longer to call an operation than to do it.
- In bfloat16, modes that are 8-bit numbers with a scale each, as in files of weights, stay so: a fourth of what has to
  be read for a map.
"""

from __future__ import annotations

import copy
from array import array
from typing import Any, cast

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
        self._features = model.features
        self._begun = _layer(cast("nn.Linear", model.trunk[0]))
        self._residuals = [tuple(map(_layer, part.layers[::2])) for part in cast("Any", model.trunk[2:])]
        self._modes = _Modes(_merged(model.modes, model), dtype)
        # Coefficients, scaled for the modes, and gains by one product.
        self._ends = _joined(model.coefficients, self._modes.factors(model.scale), model.film)
        mean = _padded(model.mean.reshape(1, COARSE**3, *self.blocks))
        # What the mean map and the biases give, whatever theta is: (1,25600) before the interpolation, where it is all
        # of it, or (80,64 x 40) after it.
        self._mean = self._constant = None
        if model.last.bias is None:
            self._mean = _merged(model.mean[None], model)
        else:
            constant = model.interpolated_blocks(mean) + model.last.bias.view(1, -1, 1, 1, 1)
            self._constant = merge(constant, FINE).reshape(FINE * self.blocks[0], -1).clone()
        self._place = _rows(model.first(mean) + model.place).to(dtype)
        self._by_y = interpolation_matrix(self.blocks[1])
        self._by_z = interpolation_matrix(self.blocks[2]).t().contiguous()
        self._bordered = _bordered(self.blocks)
        self._first = _beside(model.first.weight)
        self._added = None
        if model.interpolate is not None:
            self._added = _beside((model.interpolate.weight - trilinear()).to(dtype))
        middle = cast("list[nn.Conv3d]", list(model.middle))
        self._middle = [(_beside(layer.weight), cast("Tensor", layer.bias)) for layer in middle]
        self._pointwise = None if model.pointwise is None else _columns(model.pointwise, dtype)
        self._last = _columns(model.last, dtype)

    @torch.inference_mode()
    def __call__(self, theta: Tensor) -> Tensor:
        """Maps (B,1,80,64,40) [mm] of theta (B,4)."""
        # A second thread takes a twentieth off bfloat16's time where both cores are free. Where they are not, threads
        # that wait for each other by spinning take many times as long.
        with threads(1 if self.dtype == torch.bfloat16 else torch.get_num_threads()):
            return self._maps(theta)

    def _maps(self, theta: Tensor) -> Tensor:
        maps = torch.empty(len(theta), 1, *(FINE * count for count in self.blocks))
        gained = (len(self._middle) + 1) * 2 * self.channels
        for row, target in zip(theta.tolist(), maps, strict=True):
            found = torch.addmv(*self._ends, self._state(row))
            gains = found[-gained:].view(-1, 2, self.channels)
            self._map(self._modes(found[None, :-gained]), gains, target.view(FINE * self.blocks[0], -1))
        return maps

    def _state(self, theta: list[float]) -> Tensor:
        """Output of the trunk for one theta."""
        features = torch.frombuffer(array("f", self._features.of_one(theta)), dtype=torch.float32)
        x = nn.functional.silu(torch.addmv(*self._begun, features))
        for one, two in self._residuals:
            x = x + torch.addmv(*two, nn.functional.silu(torch.addmv(*one, x)))
        return x

    def _map(self, coarse: Tensor, gains: Tensor, target: Tensor) -> None:
        """One map (80,64 x 40) of the coarse map's difference from the mean map (1,25600), and of gains (D,2,C)."""
        nx, ny, nz = self.blocks
        pairs = coarse.to(self.dtype).view(-1).view(PAIRS[self.dtype]).index_select(0, self._bordered)
        corrections = self._corrections(pairs.view(self.dtype).view(1, nx + 2, nz + 2, ny + 2, -1), gains)
        if self._mean is not None:
            coarse += self._mean
        fours = corrections.view(FOURS[self.dtype]).view(nx, nz, ny, FINE, FINE)
        target.copy_(fours.permute(0, 3, 2, 4, 1).contiguous().view(self.dtype).view_as(target))
        if self._constant is not None:
            target += self._constant
        lines = (coarse.view(-1, COARSE * nz) @ self._by_z).view(COARSE * nx, COARSE * ny, -1)
        _add_finer(torch.matmul(self._by_y, lines).view(COARSE * nx, -1), target)

    def _corrections(self, around: Tensor, gains: Tensor) -> Tensor:
        """(3200,64) of the coarse map (1,22,12,18,8) in blocks, with a block more at each side."""
        nx, ny, nz = self.blocks
        (gain, shift), *others = gains
        by = 1 + gain
        weight = _scaled(self._first, by).to(self.dtype)
        if self._added is not None:
            weight = torch.cat([weight, self._added])
            shift = nn.functional.pad(shift, (0, len(self._added)))
        found = _convolved(around, weight, shift, 0)
        x = torch.addcmul(found[:, : self.channels], self._place, by.to(self.dtype))
        x = nn.functional.leaky_relu_(x, LEAK)
        kept = [x]
        for (weight, bias), (gain, shift) in zip(self._middle, others, strict=True):
            by = 1 + gain
            grid, scaled = x.view(1, nx, nz, ny, -1), _scaled(weight, by).to(self.dtype)
            new = nn.functional.leaky_relu_(_convolved(grid, scaled, torch.addcmul(shift, bias, by), 1), LEAK)
            x = new.add_(x) if self._pointwise is None else new
            kept.append(x)
        if self._pointwise is None:
            return torch.addmm(found[:, self.channels :], x, self._last)
        kept.append(nn.functional.leaky_relu_(x @ self._pointwise, LEAK))
        # One product, whose sums are rounded once.
        return torch.cat(kept, 1) @ self._last


class _Modes:
    """Coarse maps (1,25600), less the mean map, of coefficients (1,modes) times `factors`."""

    def __init__(self, modes: Tensor, dtype: torch.dtype) -> None:
        self._large, self._small = modes.contiguous(), None
        self._factors = torch.ones(len(modes))
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
        self._small = packed, torch.ones(len(packed), dtype=dtype)
        # It is no documented part of torch, so that it has to show that it works.
        sample = torch.cos(torch.arange(len(modes), dtype=torch.float32))
        exact = sample @ modes
        self._large = modes[:FINE_ROWS].contiguous()
        self._factors = torch.cat([torch.ones(FINE_ROWS), scale, torch.zeros(rows - len(rest))])
        found = self((nn.functional.pad(sample, (0, rows - len(rest))) * self._factors)[None])
        if not (found - exact).abs().max() <= LARGEST_ERROR * exact.abs().max():
            self._large, self._small, self._factors = modes.contiguous(), None, torch.ones(len(modes))

    def factors(self, scale: Tensor) -> Tensor:
        """Of coefficients in units of `scale`; zeros at the end fill them up."""
        return nn.functional.pad(scale, (0, len(self._factors) - len(scale))) * self._factors

    def __call__(self, coefficients: Tensor) -> Tensor:
        if self._small is None or self._product is None:
            return coefficients @ self._large
        small = self._product(coefficients[:, FINE_ROWS:].bfloat16(), *self._small)
        return (coefficients[:, :FINE_ROWS] @ self._large).add_(small)


def _merged(modes: Tensor, model: SDMNNPlus) -> Tensor:
    """Modes (N,25600) by blocks, in the order of the coarse map's voxels."""
    return merge(modes.detach().reshape(-1, COARSE**3, *model.blocks), COARSE).flatten(1)


def _layer(layer: nn.Linear) -> tuple[Tensor, Tensor]:
    """Bias and weights of a linear layer of one vector, as `addmv` takes them, in the order that it reads fastest."""
    return layer.bias.detach(), layer.weight.detach().t().contiguous().t()


def _joined(coefficients: nn.Linear, factors: Tensor, film: nn.Linear) -> tuple[Tensor, Tensor]:
    """One such layer with the outputs of the first, filled up with zeros, times `factors`, and those of the last."""
    more = len(factors) - coefficients.out_features
    bias = nn.functional.pad(coefficients.bias, (0, more)) * factors
    weight = nn.functional.pad(coefficients.weight.t(), (0, more)) * factors
    return torch.cat([bias, film.bias]), torch.cat([weight, film.weight.t()], 1).t()


def _bordered(blocks: tuple[int, ...]) -> Tensor:
    """(22*12*18*4,): places in a coarse map, of pairs along z, that are the blocks with a block more at each side."""
    nx, ny, nz = blocks
    number = torch.arange(COARSE**2 * nx * ny * nz, dtype=torch.float32).view(nx, COARSE, ny, COARSE, nz)
    channels = number.permute(1, 3, 0, 2, 4).reshape(1, COARSE**2, nx, ny, nz)
    return _padded(channels)[0].permute(1, 3, 2, 0).reshape(-1).long()


def _add_finer(planes: Tensor, target: Tensor) -> None:
    """Add planes (40,P) to twice as many (80,P), by what `interpolation_matrix` has: 3/4 and 1/4 of neighbours."""
    pairs = target.view(len(planes), 2, -1)
    even, odd = pairs.unbind(1)
    pairs.add_(planes[:, None], alpha=0.75)
    even[1:].add_(planes[:-1], alpha=0.25)
    odd[:-1].add_(planes[1:], alpha=0.25)
    even[0].add_(planes[1], alpha=0.25)
    odd[-1].add_(planes[-2], alpha=0.25)


def _padded(maps: Tensor) -> Tensor:
    """With a block more at each side, as the border's."""
    return nn.functional.pad(maps, (1,) * 6, mode="replicate")


def _beside(weight: Tensor) -> Tensor:
    """The weights of a convolution for maps (1,C,x,z,y), with channels side by side."""
    return weight.detach().transpose(3, 4).clone(memory_format=torch.channels_last_3d)


def _columns(layer: nn.Conv3d, dtype: torch.dtype) -> Tensor:
    """The weights (O,C,1,1,1) of a convolution of single blocks as (C,O)."""
    return layer.weight.detach().flatten(1).t().to(dtype).contiguous()


def _scaled(weight: Tensor, gains: Tensor) -> Tensor:
    return weight * gains.view(-1, 1, 1, 1, 1)


def _rows(maps: Tensor) -> Tensor:
    """Maps (1,C,x,y,z) as (x z y, C)."""
    return maps[0].transpose(2, 3).flatten(1).t().contiguous()


def _convolved(maps: Tensor, weight: Tensor, bias: Tensor, padding: int) -> Tensor:
    """The convolution of maps (1,x,z,y,C), as (x z y, C)."""
    maps, bias = maps.permute(0, 4, 1, 2, 3), bias.to(weight.dtype)
    if weight.dtype == torch.float32 and torch.backends.mkldnn.is_available():
        # On one thread torch takes a way of its own for float32, of three times the time.
        found = torch.mkldnn_convolution(maps, weight, bias, [padding] * 3, [1] * 3, [1] * 3, 1)
    else:
        found = torch.conv3d(maps, weight, bias, padding=padding)
    return found.permute(0, 2, 3, 4, 1).reshape(-1, len(weight))
