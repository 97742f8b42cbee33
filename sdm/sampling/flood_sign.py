"""Signs of points by a flood: those of voxels that they can be joined to without crossing the surface."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.mesh_index import MeshIndex

VOXELS = 128
# Room around what the grid has to hold, in voxels.
BORDER = 3
# How often a point that no voxel vouches for is moved away from the surface, by twice as much each time.
STEPS = 4


def flood_signs(
    index: MeshIndex, points: Tensor, distances: Tensor, closest: Tensor, hole_size: float | None
) -> tuple[Tensor, int]:
    """Distances (N,) of points (N,3) with the sign of a flood, given their closest points (N,3).

    A point has the sign of a voxel if the balls around both, as large as their distances, cover the way between them,
    which then crosses no surface. A point that is nearer to the surface than the voxels are wide is moved straight away
    from it first, as long as balls cover the way.

    Returns:
        The distances, and the number of points whose sign stays that of the nearest voxel without such a proof.
    """
    grid = _grid_around(index, points)
    field = index.signed_distance_map(grid, sign="flood", hole_size=hole_size)
    origin = torch.tensor(grid.origin, dtype=torch.float64, device=points.device)
    spacing = torch.tensor(grid.spacing, dtype=torch.float64, device=points.device)
    most = torch.tensor(grid.shape, device=points.device) - 1
    inside = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    left = torch.arange(len(points), device=points.device)
    at, far = points, distances.abs()
    away = torch.nn.functional.normalize((points - closest).double(), dim=1).float()
    step = float(max(grid.spacing))
    for turn in range(STEPS + 1):
        place = ((at.double() - origin) / spacing).round().long()
        place = torch.minimum(place.clamp(min=0), most)
        voxel = field.values[place[:, 0], place[:, 1], place[:, 2]]
        way = (origin + place * spacing - at.double()).norm(dim=1)
        inside[left] = voxel < 0
        free = far.double() + voxel.abs().double() > way * (1 + 1e-6)
        keep = ~free
        left, at, far, away = left[keep], at[keep], far[keep], away[keep]
        if not len(left) or turn == STEPS:
            break
        moved = at + step * away
        reach = index.signed_distance(moved, sign="none").abs()
        # Where another sheet is near, the way to the new place is not free: the point stays.
        covered = far + reach >= step * (1 - 1e-6)
        at, far = torch.where(covered[:, None], moved, at), torch.where(covered, reach, far)
        step *= 2
    values = torch.where(inside, -distances.abs(), distances.abs())
    return values, len(left)


def _grid_around(index: MeshIndex, points: Tensor) -> Grid:
    low, high = (torch.as_tensor(end, device="cpu") for end in index.mesh.bounds)
    low = torch.minimum(low, points.amin(0).double().cpu())
    high = torch.maximum(high, points.amax(0).double().cpu())
    spacing = float((high - low).max()) / (VOXELS - 2 * BORDER)
    shape = [int(n) for n in ((high - low) / spacing).ceil() + 2 * BORDER]
    return Grid((low - BORDER * spacing).tolist(), (spacing, spacing, spacing), shape)
