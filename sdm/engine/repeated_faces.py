"""Repeated faces of a mesh: measured once, and counted for the sign as often as they are there.

A hierarchy cannot tell copies apart, so that each of n copies is looked at for every voxel. Where a few triangles come
very often, one copy of each is left for distances. The generalised winding number is a sum over all triangles: that of
the others, by their own structure, and of each repeated triangle its solid angle (van Oosterom and Strackee 1983) times
its copies, those that face the other way subtracted.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float32, Int32
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.voxel_points import voxel_points
from sdm.engine.acceleration import AccelerationStructure, build
from sdm.engine.ops import points_winding
from sdm.engine.structure.sizes import MOST_BOUNDARY_EDGES
from sdm.inspect.duplicates import first_copies
from sdm.inspect.positions import first_at_position
from sdm.topology.boundary_edges import boundary_edges

# Copies of a triangle that are worth it, and triangles with so many, whose solid angles are worked out one by one.
FEWEST_COPIES, MOST_TRIANGLES = 64, 64
# Boundary edges between two vertices, and faces a vertex, from which on it is worth a look.
CROWDED = 32
# Faces from which on a GPU, which measures many copies in little time, is better off with one of each.
FEWEST_ON_GPU = 1 << 16
# Points at a time, for so many triangles; on a GPU points times triangles.
CHUNK = 1 << 14
CHUNK_ON_GPU = 1 << 20


def may_be_crowded(mesh: TriangleMesh, edges: Int32[Tensor, "E 2"]) -> bool:
    """True if a mesh with these boundary edges may have triangles many times."""
    # Copies of triangles leave edges as often as they are there; if they close a surface, they have few vertices.
    count, gpu = mesh.vertices.shape[0], mesh.device.type != "cpu"
    if gpu and len(mesh) < FEWEST_ON_GPU:
        return False
    if len(mesh) >= CROWDED * count:
        return True
    # What follows waits for a GPU: only where no face has a vertex in common with another, and few edges cancel.
    if gpu and not (count >= 3 * len(mesh) and edges.shape[0] >= 2 * len(mesh)):
        return False
    return edges.shape[0] >= CROWDED and bool((edges[CROWDED - 1 :] == edges[: 1 - CROWDED]).all(1).any())


class RepeatedFaces:
    """A mesh with triangles that it has many times.

    Args:
        distinct: The mesh with one copy of each of these.
        kept: (F',) the mesh's own number of each face of `distinct`: of copies the smallest.
        others: The mesh without them, and its structure; None if nothing is left.
        corners: (H,3,3) float64, one copy of each.
        copies: (H,) float64, how often each is there, less how often the other way round.
    """

    def __init__(
        self,
        distinct: TriangleMesh,
        kept: Int32[Tensor, " F"],
        others: tuple[TriangleMesh, AccelerationStructure] | None,
        corners: Tensor,
        copies: Tensor,
    ) -> None:
        self.distinct = distinct
        self._kept, self._others, self._corners, self._copies = kept, others, corners, copies

    def faces(self, found: Int32[Tensor, "*n"]) -> Int32[Tensor, "*n"]:
        """The mesh's own numbers of faces of `distinct`; -1 stays -1."""
        return torch.where(found < 0, found, self._kept[found.clamp(min=0).long()])

    def winding(self, points: Float32[Tensor, "n 3"]) -> Float32[Tensor, " n"]:
        """Generalised winding number of the whole mesh about points (N,3)."""
        chunk = CHUNK_ON_GPU // len(self._copies) if points.is_cuda else CHUNK
        total = torch.cat([self._repeated(some) for some in points.double().split(chunk)])
        if self._others is not None:
            mesh, structure = self._others
            total += points_winding(mesh.vertices.detach(), mesh.faces, points.contiguous(), structure)
        return total.float()

    def signed(self, values: Float32[Tensor, " n"], points: Float32[Tensor, "n 3"]) -> Float32[Tensor, " n"]:
        """Distances from `distinct` at points (N,3), with the sign of the whole mesh."""
        return torch.where(self.winding(points.detach()) > 0.5, -values.abs(), values.abs())

    def signed_slab(self, values: Float32[Tensor, "1 n ny nz"], grid: Grid, begin: int) -> tuple[Tensor, Tensor]:
        """Layers of a map from `begin` on with the sign of the whole mesh, and how many voxels are ambiguous (1,)."""
        end = begin + values.shape[1]
        thick = 1 + CHUNK_ON_GPU // values[0, 0].numel() if values.is_cuda else 1
        number = torch.cat(
            [
                self.winding(grid.points(layer, min(layer + thick, end)).reshape(-1, 3).to(values.device))
                for layer in range(begin, end, thick)
            ]
        ).reshape(values.shape)
        ambiguous = ((number - 0.5).abs() < 0.25).sum(dtype=torch.int32).reshape(1)
        return torch.where(number > 0.5, -values.abs(), values.abs()), ambiguous

    def sign_blocks(
        self, values: Float32[Tensor, "n 8 8 8"], blocks: Int32[Tensor, "n 3"], grid: Grid, width: float
    ) -> int:
        """Give the values of blocks the sign of the whole mesh; how many nearer than `width` are ambiguous."""
        ambiguous = 0
        inner = torch.cartesian_prod(*3 * [torch.arange(8, device=values.device)])
        last = torch.tensor(grid.shape, device=values.device)
        for some, theirs in zip(blocks.split(256), values.split(256), strict=True):
            voxels = (8 * some.long()[:, None] + inner).view(-1, 3)
            number = self.winding(voxel_points(grid, voxels)).view_as(theirs)
            # Beyond the grid nothing is inside.
            number[~(voxels < last).all(1).view_as(theirs)] = 0
            ambiguous += int((((number - 0.5).abs() < 0.25) & (theirs < width)).sum())
            theirs.copy_(torch.where(number > 0.5, -theirs, theirs))
        return ambiguous

    def _repeated(self, points: Tensor) -> Tensor:
        a, b, c = (self._corners[None] - points[:, None, None]).unbind(2)
        la, lb, lc = a.norm(dim=2), b.norm(dim=2), c.norm(dim=2)
        volume = (a * torch.linalg.cross(b, c)).sum(2)
        below = la * lb * lc + (a * b).sum(2) * lc + (b * c).sum(2) * la + (c * a).sum(2) * lb
        return torch.atan2(volume, below) @ self._copies / (2 * math.pi)


def repeated_faces(mesh: TriangleMesh) -> RepeatedFaces | None:
    """The triangles that a mesh has many times; None if there are none, or too many different ones.

    They are looked for on the host.
    """
    device = mesh.device
    vertices, faces = mesh.numpy()
    first, same_side = first_copies(first_at_position(vertices)[faces.astype(np.int64)], len(vertices))
    heavy = np.bincount(first, minlength=len(faces)) >= FEWEST_COPIES
    names = np.flatnonzero(heavy)
    if not 0 < len(names) <= MOST_TRIANGLES:
        return None
    rest = ~heavy[first]
    others = None
    if rest.any():
        left = TriangleMesh(mesh.vertices, mesh.faces[torch.from_numpy(rest).to(device)], mesh.name, check=False)
        border = boundary_edges(left.vertices, left.faces)
        # Winding numbers of more are right about a half alone, and here something is added to them.
        if border.shape[0] > MOST_BOUNDARY_EDGES:
            return None
        others = left, build(left.vertices.detach()[None], left.faces, border)
    kept = torch.from_numpy(np.flatnonzero(rest | heavy).astype(np.int32)).to(device)
    distinct = TriangleMesh(mesh.vertices, mesh.faces[kept.long()], mesh.name, check=False)
    copies = np.bincount(first, np.where(same_side, 1.0, -1.0), minlength=len(faces))[names]
    corners = torch.from_numpy(vertices[faces[names]].astype(np.float64))
    return RepeatedFaces(distinct, kept, others, corners.to(device), torch.from_numpy(copies).to(device))
