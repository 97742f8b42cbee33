"""Trilinear interpolation of values on a grid."""

from __future__ import annotations

from itertools import product

import torch
from jaxtyping import Float
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.voxel_points import places_on


def trilinear(values: Float[Tensor, "nx ny nz"], grid: Grid, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
    """Values (N,) at points (N,3), between the eight voxel centres around each; NaN beyond the grid.

    Differentiable in values and points. Weights are computed in float64.
    """
    size = torch.tensor(grid.shape, device=values.device)
    place, beyond = places_on(grid, points)
    low = place.detach().nan_to_num().floor().long().clamp(min=0).minimum((size - 2).clamp(min=0))
    high = (low + 1).minimum(size - 1)
    weight = place - low
    found = torch.zeros(len(points), dtype=torch.float64, device=values.device)
    for corner in product((False, True), repeat=3):
        index = [(high if upper else low)[:, axis] for axis, upper in enumerate(corner)]
        share = [weight[:, axis] if upper else 1 - weight[:, axis] for axis, upper in enumerate(corner)]
        found = found + share[0] * share[1] * share[2] * values[tuple(index)]
    return found.to(values.dtype).masked_fill(beyond, torch.nan)
