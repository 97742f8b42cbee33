"""Tricubic interpolation of values on a grid, by cubic convolution."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.voxel_points import places_on


def tricubic(values: Float[Tensor, "nx ny nz"], grid: Grid, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
    """Values (N,) at points (N,3) from the 64 voxel centres around each; NaN beyond the grid.

    Cubic convolution with slope -1/2 (R. Keys, Cubic convolution interpolation for digital image processing, 1981):
    equal to the values at the voxel centres, with continuous first derivatives, and exact for quadratic maps. Beyond
    the outermost centres the map is taken to go on straight. Differentiable in values and points, which is smooth
    where `trilinear` has kinks. Weights are computed in float64.
    """
    place, beyond = places_on(grid, points)
    axes = [cubic_weights(place[:, axis], count) for axis, count in enumerate(grid.shape)]
    (x, x_share), (y, y_share), (z, z_share) = axes
    flat = values.reshape(-1)
    _, ny, nz = grid.shape
    found = torch.zeros(len(points), dtype=torch.float64, device=values.device)
    for i in range(4):
        for j in range(4):
            row = (x[:, i] * ny + y[:, j]) * nz
            along = (z_share * flat[row[:, None] + z]).sum(1)
            found = found + x_share[:, i] * y_share[:, j] * along
    return found.to(values.dtype).masked_fill(beyond, torch.nan)


def cubic_weights(place: Float[Tensor, " n"], count: int) -> tuple[Tensor, Tensor]:
    """The four voxels (N,4) around each place along an axis of `count`, and their weights (N,4)."""
    low = place.detach().nan_to_num().floor().long().clamp(0, max(count - 2, 0))
    t = place - low
    before = t * (t * (2 - t) - 1) / 2
    first = (t * t * (3 * t - 5) + 2) / 2
    second = t * (t * (4 - 3 * t) + 1) / 2
    after = t * t * (t - 1) / 2
    # What is beyond the border goes on straight: f(-1) = 2 f(0) - f(1).
    begins, ends = low == 0, low >= count - 2
    none = torch.zeros_like(t)
    left, right = torch.where(begins, before, none), torch.where(ends, after, none)
    shares = (before - left, first + 2 * left - right, second + 2 * right - left, after - right)
    voxels = low[:, None] + torch.arange(-1, 3, device=place.device)
    return voxels.clamp(0, count - 1), torch.stack(shares, 1)
