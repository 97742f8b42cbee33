"""Centres of single voxels of a grid."""

from __future__ import annotations

import torch
from jaxtyping import Float32, Int64
from torch import Tensor

from sdm.core.grid import Grid


def voxel_points(grid: Grid, voxels: Int64[Tensor, "n 3"]) -> Float32[Tensor, "n 3"]:
    """Centres (N,3) of voxels (N,3), bit for bit those of `Grid.points`."""
    i, j, k = voxels.double().unbind(-1)
    found = []
    for axis in range(3):
        row = [d * s for d, s in zip(grid.direction[axis], grid.spacing, strict=True)]
        found.append(grid.origin[axis] + (row[0] * i + row[1] * j + row[2] * k))
    return torch.stack(found, -1).float()
