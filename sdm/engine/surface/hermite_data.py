"""Crossings of voxel edges with normals, which dual contouring is made of: of the map alone, or of its mesh."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.core.sparse_sdm import SparseSDM
from sdm.engine.mesh_index import MeshIndex

STEPS = 4
# Of an edge, so that no crossing reaches its ends; see `kernels/surface/marching_cubes.py`.
CLEARANCE = 1 / 1024
# A plane along an edge says nothing of where it is crossed.
ALONG = 1e-3


def map_normals(field: SDM | SparseSDM, points: Tensor) -> Tensor:
    """Unit normals (V,3) by differences of the map's values half a voxel to either side of points (V,3)."""
    axes = torch.from_numpy(field.grid.affine[:3, :3]).to(points.device)
    middle = field.sample(points)
    slopes = []
    for axis in range(3):
        step = 0.5 * axes[:, axis]
        ends = [field.sample(points.double() + side * step) for side in (1, -1)]
        # Beyond the outermost voxels there is one side.
        ahead, behind = (torch.where(end.isnan(), middle, end) for end in ends)
        slopes.append((ahead - behind).double())
    gradient = torch.stack(slopes, 1) @ torch.linalg.inv(axes)
    return torch.nn.functional.normalize(gradient, dim=1).float()


def mesh_crossings(index: MeshIndex, grid: Grid, level: float, points: Tensor, ways: Tensor) -> tuple[Tensor, Tensor]:
    """Crossings of voxel edges with the surface at a level itself, and its normals there.

    Newton's method along each edge, by the planes at the closest points: exact after a step where the surface is flat.

    Args:
        index: Of the mesh that the map is of.
        grid: Of the map.
        level: Where unsigned distances are as long, the surface is.
        points: (V,3) first guesses, on the edges.
        ways: (V,3) from the first voxel of each edge to the second.

    Returns:
        Points (V,3) and normals (V,3), which may face either way.
    """
    to_voxels = torch.linalg.inv(torch.from_numpy(grid.affine[:3, :3]).to(points.device))
    origin = torch.tensor(grid.origin, dtype=torch.float64, device=points.device)
    lengths = ways.double().norm(dim=1)
    way = ways.double() / lengths[:, None]
    # The share of its edge at which each first guess lies, to begin the edge there.
    places = (points.double() - origin) @ to_voxels.T
    share = ((places - places.round()) * (ways.double() @ to_voxels.T)).sum(1)
    share = torch.where(share < 0, share + 1, share)
    start = points.double() - (share * lengths)[:, None] * way
    edges = Edges(start, way, lengths)
    best, normals, error = _newton(index, level, edges, share)
    # At edges and corners of the mesh the closest plane may not be the one that is met: then from either end.
    for end in (CLEARANCE, 1 - CLEARANCE):
        left = (error > CLEARANCE * lengths).nonzero()[:, 0]
        if not len(left):
            break
        part = Edges(start[left], way[left], lengths[left])
        found, normal, away = _newton(index, level, part, torch.full_like(part.lengths, end))
        better = away < error[left]
        kept = left[better]
        best[kept], normals[kept], error[kept] = found[better], normal[better], away[better]
    return best.float(), normals.float()


class Edges(NamedTuple):
    """Voxel edges: first ends (V,3), unit vectors along them (V,3) and lengths (V,), float64."""

    start: Tensor
    way: Tensor
    lengths: Tensor


def _newton(index: MeshIndex, level: float, edges: Edges, share: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """From shares (V,) of edges, the best points (V,3) of a few steps, normals there (V,3) and distances from it."""
    start, way, lengths = edges
    best = start + (share * lengths)[:, None] * way
    at, error, kept = best, torch.full_like(lengths, torch.inf), torch.zeros_like(way)
    for step in range(STEPS + 1):
        distance, hit = index.signed_distance(at.float(), return_closest=True, sign="none")
        normals = _normals(index, hit, at, level)
        # Where two planes take turns, the best of all is kept.
        away = (distance.double() - abs(level)).abs()
        better = (away < error)[:, None]
        best, kept, error = torch.where(better, at, best), torch.where(better, normals, kept), away.minimum(error)
        if step == STEPS:
            break
        ahead = abs(level) - distance.double()
        height = ((hit.points.double() - at) * normals).sum(1) if level == 0 else ahead
        slope = (way * normals).sum(1)
        moved = torch.where(slope.abs() > ALONG, height / torch.where(slope.abs() > ALONG, slope, 1.0), 0.0)
        share = (share + moved / lengths).clamp(CLEARANCE, 1 - CLEARANCE)
        at = start + (share * lengths)[:, None] * way
    return best, kept, error


def _normals(index: MeshIndex, hit: Any, at: Tensor, level: float) -> Tensor:
    """At level 0 those of the closest faces, else the ways from the closest points."""
    if level != 0:
        return torch.nn.functional.normalize(at - hit.points.double(), dim=1)
    corners = index.mesh.vertices.detach()[index.mesh.faces[hit.faces.long().clamp(min=0)].long()].double()
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return torch.nn.functional.normalize(normal, dim=1, eps=0.0)
