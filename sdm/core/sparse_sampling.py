"""Interpolation of the values of a narrow band."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from sdm.core.trilinear import SLACK

if TYPE_CHECKING:
    from sdm.core.sparse_sdm import SparseSDM

# Points that are interpolated at a time: of each up to 64 voxels are looked up.
CHUNK = 1 << 17


def interpolate(band: SparseSDM, points: Float[Tensor, "n 3"], order: int) -> Float[Tensor, " n"]:
    """Values (N,) at points (N,3) float64, of order 1 (8 voxels) or 3 (64); NaN beyond the grid."""
    if len(points) > CHUNK:
        return torch.cat([interpolate(band, some, order) for some in points.split(CHUNK)])
    size = torch.tensor(band.shape, device=band.device)
    turn = torch.tensor(band.grid.direction, dtype=torch.float64, device=band.device)
    step = torch.tensor(band.grid.spacing, dtype=torch.float64, device=band.device)
    origin = torch.tensor(band.grid.origin, dtype=torch.float64, device=band.device)
    place = (points - origin) @ turn / step
    # False for NaN too.
    beyond = ~((place >= -SLACK) & (place <= size - 1 + SLACK)).all(1)
    low = place.detach().nan_to_num().floor().long().clamp(min=0).minimum((size - 2).clamp(min=0))
    share = place - low
    weights = torch.stack(_linear(share) if order == 1 else _cubic(share), -1)
    first = 0 if order == 1 else -1
    offsets = torch.tensor(list(product(range(first, first + weights.shape[-1]), repeat=3)), device=band.device)
    # Next to the grid's ends the outermost voxels stand for those beyond.
    voxels = (low[:, None] + offsets).clamp(min=0).minimum(size - 1)
    x, y, z = (weights[:, axis][:, offsets[:, axis] - first] for axis in range(3))
    found = (x * y * z * band.at(voxels)).sum(-1)
    return found.to(band.values.dtype).masked_fill(beyond, torch.nan)


def _linear(t: Tensor) -> list[Tensor]:
    return [1 - t, t]


def _cubic(t: Tensor) -> list[Tensor]:
    """Weights of cubic convolution with a = -1/2 (Keys 1981), of the voxels -1 to 2."""
    return [
        0.5 * t * (-1 + t * (2 - t)),
        1 + 0.5 * t * t * (-5 + 3 * t),
        0.5 * t * (1 + t * (4 - 3 * t)),
        0.5 * t * t * (t - 1),
    ]
