"""Closest points in float64, with the face that looks at the point among those that are equally near."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import MeshError
from sdm.inspect.positions import first_at_position
from sdm.runtime.threads import one_thread_for
from sdm.topology.face_pairing import pairing_of

# Squared distances that differ by no more than rounding, relative to the mesh's squared size.
ROUNDING = 1e-15
# Share of a corner below which a closest point may lie on the edge across from it; of slivers float32 knows no better.
ON_AN_EDGE = 1e-2
# Points that are worked on at a time, a kilobyte each.
CHUNK, GPU_CHUNK = 1 << 11, 1 << 20


class ClosestInFloat64:
    """A mesh with float64 vertices, and an index of it about its own middle, so that float32 has all its digits there.

    Args:
        vertices: (V,3) coordinates.
        faces: (F,3) vertex indices.
        device: Where to compute; by default a GPU if there is one.
        equal: Squared distances that differ by no more than this share of themselves count as equal, too.
        name: What messages call the mesh.

    Raises:
        MeshError: Arrays that are no mesh.

    The index finds a face in float32. The closest point on it and on its three neighbours is worked out in float64; of
    those that are equally near the face is named whose front looks at the point most.
    """

    def __init__(
        self,
        vertices: Any,
        faces: Any,
        device: str | torch.device | None = None,
        *,
        equal: float = 0.0,
        name: str = "mesh",
    ) -> None:
        corners = np.asarray(vertices, dtype=np.float64)
        # Shapes and values are looked at first.
        whole = TriangleMesh(corners, faces, name)
        low, high = whole.bounds
        self.middle = (low + high) / 2
        self.equal, self.rounding = equal, ROUNDING * float(((high - low) ** 2).sum())
        self.index = MeshIndex(TriangleMesh(corners - self.middle, whole.faces, name, check=False), device, warn=False)
        where = self.index.device
        # By NumPy: torch's threads take longer to meet.
        self._corners = torch.from_numpy((corners - self.middle)[whole.faces.cpu().numpy()]).to(where)
        with one_thread_for(0, where):
            self._normals = _normals(self._corners)
        self._near = _neighbours(np.asarray(vertices, np.float32), self.index.mesh.faces)

    def query(self, points: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Signed distances (N,) negative inside, closest points (N,3), both float64, faces (N,) int64, normals (N,3).

        Args:
            points: (N,3) coordinates.

        Raises:
            MeshError: The points are not (N,3).
        """
        at = np.asarray(points, dtype=np.float64)
        if at.ndim != 2 or at.shape[1] != 3:
            raise MeshError(f"the points have shape {at.shape}; (N, 3) is needed")
        moved = torch.from_numpy(at - self.middle).to(self.index.device)
        signed, hit = self.index.signed_distance(moved.float(), return_closest=True)
        # Many operations on what fits into a cache.
        with one_thread_for(0, self.index.device):
            size = CHUNK if self.index.device.type == "cpu" else GPU_CHUNK
            parts = zip(moved.split(size), hit.faces.split(size), hit.barycentric.split(size), strict=True)
            found = [self._refined(*part) for part in parts]
        closest, distance, face = (torch.cat(parts) for parts in zip(*found, strict=True))
        distance = torch.where(signed < 0, -distance, distance)
        normals = self._normals[face]
        where = closest.cpu().numpy() + self.middle
        return distance.cpu().numpy(), where, face.cpu().numpy(), normals.cpu().numpy()

    def _refined(self, points: Tensor, faces: Tensor, barycentric: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Closest points, distances, faces; only where an edge or a corner is nearest may another face be as near."""
        own = faces.clamp(min=0).long()
        closest = closest_on_triangles(self._corners[own], points)
        distance = _squared(points - closest).sqrt()
        beside = (barycentric.amin(1) <= ON_AN_EDGE).nonzero()[:, 0]
        if len(beside):
            picked = self._best_of_neighbours(points[beside], own[beside])
            closest[beside], distance[beside], own[beside] = picked
        return closest, distance, own

    def _best_of_neighbours(self, points: Tensor, known: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        candidates = torch.cat([known[:, None], self._near[known]], 1)
        closest = closest_on_triangles(self._corners[candidates], points[:, None])
        way = points[:, None] - closest
        squared = (way * way).sum(-1)
        least = squared.amin(1, keepdim=True)
        length = squared.sqrt().clamp(min=torch.finfo(torch.float64).tiny)
        front = (self._normals[candidates] * way).sum(-1) / length
        equal = squared <= (1 + self.equal) * least + self.rounding
        # A point on the surface has no side: the nearest face is its own.
        equal &= (least > self.rounding) | (squared == least)
        # Of equal ones the first: that which the index names.
        chosen = front.masked_fill(~equal, -2.0).round(decimals=9).argmax(1, keepdim=True)
        picked = closest.gather(1, chosen[..., None].expand(-1, 1, 3))[:, 0]
        return picked, squared.gather(1, chosen)[:, 0].sqrt(), candidates.gather(1, chosen)[:, 0]


def closest_on_triangles(corners: Tensor, points: Tensor) -> Tensor:
    """Points of triangles (...,3,3) that are closest to points (...,3), which broadcast; any type, best float64.

    The foot on the plane where it is inside the triangle, else the nearest of the closest points of the three edges;
    triangles without an area are their edges.
    """
    a, b, c = corners.unbind(-2)
    tiny = torch.finfo(corners.dtype).tiny
    best, least = a, _squared(points - a)
    for begin, end in ((a, b), (b, c), (c, a)):
        along = end - begin
        share = ((points - begin) * along).sum(-1) / _squared(along).clamp(min=tiny)
        at = begin + share.clamp(0, 1)[..., None] * along
        squared = _squared(points - at)
        nearer = squared < least
        best, least = torch.where(nearer[..., None], at, best), torch.where(nearer, squared, least)
    normal = torch.linalg.cross(b - a, c - a)
    size = _squared(normal)
    height = ((points - a) * normal).sum(-1) / size.clamp(min=tiny)
    foot = points - height[..., None] * normal
    inside = size > 0
    for begin, end in ((a, b), (b, c), (c, a)):
        side = torch.linalg.cross(*torch.broadcast_tensors(end - begin, foot - begin))
        inside = inside & ((side * normal).sum(-1) >= 0)
    # Beside a sliver the foot's own tests are noise: it counts if it is nearer.
    inside &= _squared(points - foot) <= least
    return torch.where(inside[..., None], foot, best)


def _squared(vectors: Tensor) -> Tensor:
    return (vectors * vectors).sum(-1)


def _normals(corners: Tensor) -> Tensor:
    """Unit normals (F,3) of triangles (F,3,3); 0 for those without an area."""
    a, b, c = corners.unbind(1)
    return torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1, eps=1e-300)


def _neighbours(vertices: np.ndarray, faces: Tensor) -> Tensor:
    """For each face one that shares each of its edges (F,3) int64, on the device; itself where there is none."""
    pairing = pairing_of(faces, len(vertices))
    if not len(pairing.unmatched):
        # Closed without merging vertices at one place: what the index has found already.
        around = pairing.neighbours[:, :3].long()
        own = torch.arange(len(faces), device=faces.device)[:, None]
        return torch.where(around < 0, own, around // 3)
    first = first_at_position(vertices)
    return torch.from_numpy(_around_edges(first[faces.cpu().numpy()])).to(faces.device)


def _around_edges(corners: np.ndarray) -> np.ndarray:
    """The same of faces by their corners (F,3): the next face around each edge."""
    edges = np.sort(np.stack([corners, np.roll(corners, -1, 1)], -1), -1).reshape(-1, 2).astype(np.int64)
    key = edges[:, 0] * (int(corners.max()) + 1) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    # The next face around the edge, and after the last the first.
    group = np.flatnonzero(np.diff(key[order], prepend=-1))
    following = np.arange(1, len(order) + 1)
    following[np.append(group[1:], len(order)) - 1] = group
    near = np.empty(len(order), np.int64)
    near[order] = order[following] // 3
    return near.reshape(-1, 3)
