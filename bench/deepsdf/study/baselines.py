"""Trivial answers that a trained network has to beat: copies of the nearest training shape, and maps of few voxels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.engine.api import signed_distance_map
from sdm.sampling.near_twins import Surface, laid_on

# Training shapes that are nearest as they are, which are laid on the shape before the nearest is taken.
CANDIDATES = 8
# Room around a shape's box, in parts of its sides, and points along an axis of the map once it is enlarged.
MARGIN, FINE = 0.05, 160


class Copy(NamedTuple):
    """A training shape in place of another one: its number, its mesh, and how far it is from what was seen."""

    number: int
    mesh: TriangleMesh
    distance: float


def nearest_copy(
    shape: Surface, training: Sequence[Surface], *, seen: Tensor | None = None, laid: bool = False
) -> Copy:
    """The training shape that is nearest to a shape, all in their unit spheres.

    Args:
        shape: The shape.
        training: Those to choose from.
        seen: Points (N,3) that are all that is known of the shape; else all of its surface is.
        laid: Lay the nearest ones on what is known, by a turn and a shift, before the nearest of them is taken.
    """
    still = torch.eye(3, dtype=torch.float64, device=shape.few.device), torch.zeros_like(shape.few[0])
    as_is = [_apart(own, shape, seen, *still) for own in training]
    order = sorted(range(len(training)), key=as_is.__getitem__)
    placed = {order[0]: still}
    if laid:
        placed = {n: laid_on(training[n], shape, seen=seen) for n in order[:CANDIDATES]}
    apart = {n: _apart(training[n], shape, seen, *where) for n, where in placed.items()}
    best = min(apart, key=apart.__getitem__)
    turn, shift = placed[best]
    mesh = training[best].index.mesh
    vertices = (mesh.vertices.double() @ turn.T + shift).float()
    return Copy(best, TriangleMesh(vertices, mesh.faces, mesh.name, check=False), apart[best])


def _apart(own: Surface, shape: Surface, seen: Tensor | None, turn: Tensor, shift: Tensor) -> float:
    """Mean distance of a placed training shape from what is known: both ways, or from the points seen."""
    known = shape.few if seen is None else seen.double()
    back = (known - shift) @ turn
    found = float((back - own.nearest(back)).norm(dim=1).mean())
    if seen is not None:
        return found
    there = own.few @ turn.T + shift
    return (found + float((there - shape.nearest(there)).norm(dim=1).mean())) / 2


def coarse_map(truth: TriangleMesh, size: int, fine: int = FINE) -> TriangleMesh:
    """The surface of an exact map with size^3 voxels over the shape's box, enlarged by cubic splines."""
    from scipy.ndimage import zoom

    used = truth.vertices[truth.faces.reshape(-1).long()].double()
    low, high = used.amin(0), used.amax(0)
    room = MARGIN * (high - low)
    low, high = low - room, high + room
    values = signed_distance_map(truth, _grid(low, high, size)).values.double().cpu().numpy()
    large = torch.from_numpy(zoom(values, fine / size, order=3, mode="nearest", grid_mode=False)).float()
    return SDM(large, _grid(low, high, fine)).to_mesh().to(truth.device)


def _grid(low: Tensor, high: Tensor, size: int) -> Grid:
    """Points from corner to corner of a box."""
    return Grid(tuple(low.tolist()), tuple(((high - low) / (size - 1)).tolist()), (size,) * 3)
