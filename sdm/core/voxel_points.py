"""Centres of single voxels of a grid, and places of points among them."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Float32, Float64, Int64
from torch import Tensor

from sdm.core.grid import Grid

# Points so many voxels beyond the grid are taken for points on its border: coordinates are rounded to float32.
SLACK = 1e-3


def voxel_points(grid: Grid, voxels: Int64[Tensor, "n 3"]) -> Float32[Tensor, "n 3"]:
    """Centres (N,3) of voxels (N,3), bit for bit those of `Grid.points`."""
    i, j, k = voxels.double().unbind(-1)
    found = []
    for axis in range(3):
        row = [d * s for d, s in zip(grid.direction[axis], grid.spacing, strict=True)]
        found.append(grid.origin[axis] + (row[0] * i + row[1] * j + row[2] * k))
    return torch.stack(found, -1).float()


def places_on(grid: Grid, points: Float[Tensor, "n 3"]) -> tuple[Float64[Tensor, "n 3"], Bool[Tensor, " n"]]:
    """Places (N,3) of points (N,3), in voxels from the first centre, and which are beyond the outermost centres.

    Differentiable in the points. NaN is beyond.
    """
    like = {"dtype": torch.float64, "device": points.device}
    turn, step, origin = (torch.tensor(of, **like) for of in (grid.direction, grid.spacing, grid.origin))
    place = (points.double() - origin) @ turn / step
    size = torch.tensor(grid.shape, device=points.device)
    return place, ~((place >= -SLACK) & (place <= size - 1 + SLACK)).all(1)
