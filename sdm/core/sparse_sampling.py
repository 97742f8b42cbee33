"""Interpolation of the values of a narrow band."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from sdm.core.interpolation.tricubic import cubic_weights
from sdm.core.voxel_points import places_on

if TYPE_CHECKING:
    from sdm.core.sparse_sdm import SparseSDM

# Points that are interpolated at a time: of each four voxels are looked up together.
CHUNK = 1 << 18


def interpolate(band: SparseSDM, points: Float[Tensor, "n 3"], order: int) -> Float[Tensor, " n"]:
    """Values (N,) at points (N,3) float64, of order 1 (8 voxels) or 3 (64); NaN beyond the grid."""
    if len(points) > CHUNK:
        return torch.cat([interpolate(band, some, order) for some in points.split(CHUNK)])
    place, beyond = places_on(band.grid, points)
    axes = [cubic_weights(place[:, a], n) if order == 3 else _linear(place[:, a], n) for a, n in enumerate(band.shape)]
    (x, x_share), (y, y_share), (z, z_share) = axes
    found = torch.zeros(len(points), dtype=torch.float64, device=band.device)
    for i in range(x.shape[1]):
        for j in range(y.shape[1]):
            row = torch.stack([x[:, i, None].expand_as(z), y[:, j, None].expand_as(z), z], -1)
            found = found + x_share[:, i] * y_share[:, j] * (z_share * band.at(row)).sum(1)
    return found.to(band.values.dtype).masked_fill(beyond, torch.nan)


def _linear(place: Float[Tensor, " n"], count: int) -> tuple[Tensor, Tensor]:
    """The two voxels (N,2) around each place along an axis of `count`, and their weights (N,2)."""
    low = place.detach().nan_to_num().floor().long().clamp(0, max(count - 2, 0))
    t = place - low
    return torch.stack([low, (low + 1).clamp(max=count - 1)], 1), torch.stack([1 - t, t], 1)
