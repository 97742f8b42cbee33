"""Closest points: the result of a query beside its distances."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from jaxtyping import Float, Float32, Int32
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError

# Points that are gathered for at a time, so that numbers of 64 bits take little memory.
CHUNK = 1 << 22


@dataclass(frozen=True)
class Layers:
    """Layers of a grid, from `begin` to before `end`: the voxels of a slab."""

    grid: Grid
    begin: int
    end: int

    def points(self) -> Tensor:
        """Voxel centres (n,ny,nz,3) on the host."""
        return self.grid.points(self.begin, self.end)


@dataclass(frozen=True, eq=False)
class Closest:
    """Closest points of a query: their places, faces and barycentric coordinates.

    Of a map, n is (nx,ny,nz), of a slab (end - begin,ny,nz), and of a batch of meshes that share their faces
    (B,nx,ny,nz).

    Args:
        points: (N,3) float32, in the mesh's unit.
        faces: (N,) int32, the face that each lies on; -1 for a query point that is not finite. Of the faces that meet
            in a closest point on an edge or a corner it is the one whose plane faces the query point most (the largest
            |cos| of the angle between its normal and the way there), and of those that do so alike, to within 1e-6,
            the one with the smallest number. So at an edge of two faces its normal tells the side, however acute. For
            maps, faces that are equally near without a common edge or corner by their indices may stand for each other.
        barycentric: (N,3) float32, its barycentric coordinates on that face.

    What a mesh's vertices or faces have, closest points have too: `interpolate` and `of_faces`. Of a batch, values of
    vertices may be (V,...), the same for all meshes, or (B,V,...), and those of faces likewise.
    """

    points: Float32[Tensor, "*n 3"]
    faces: Int32[Tensor, "*n"]
    barycentric: Float32[Tensor, "*n 3"]
    _mesh: TriangleMesh | None = field(default=None, repr=False)
    _asked: Tensor | Grid | Layers | None = field(default=None, repr=False)
    _batch: int | None = field(default=None, repr=False)

    @property
    def directions(self) -> Float32[Tensor, "*n 3"]:
        """Unit vectors (N,3) from each closest point to its query point, whichever side that is on.

        Zero on the surface, NaN for a query point that is not finite. Times the distance without its sign they lead
        from the closest point to the query point; times the sign they are the gradient of the signed distance.
        """
        if self._asked is None:
            raise MeshError("these closest points were made by hand, without the points that were asked about")
        asked = self._asked
        if isinstance(asked, Tensor):
            way = asked.reshape(self.points.shape) - self.points
        else:
            way = asked.points().to(self.points.device) - self.points
        # Scaled first, as squares leave float32's range before lengths do.
        way = way / way.abs().amax(-1, keepdim=True).clamp(min=torch.finfo(torch.float32).tiny)
        return torch.nn.functional.normalize(way, dim=-1)

    def interpolate(self, vertex_values: Any) -> Float[Tensor, "*n ..."]:
        """Values of the vertices, at the closest points: between the three of the face, by barycentric coordinates.

        Args:
            vertex_values: (V,...) real numbers, an array or a tensor: normals, colours, texture coordinates, ...
                Gradients flow to them.

        Returns:
            (N,...) of their type, or float32 of whole numbers; NaN for a query point that is not finite.

        Raises:
            MeshError: There are not as many as the mesh's vertices.
        """
        mesh = self._of_mesh()
        given, meshes = self._values(vertex_values, mesh.vertices.shape[0], "vertices")
        if meshes is not None:
            return torch.stack([one.interpolate(own) for one, own in zip(meshes, given, strict=True)])
        values = given if given.is_floating_point() else given.float()
        ones = [1] * (values.ndim - 1)
        faces, weights = self.faces.reshape(-1).split(CHUNK), self.barycentric.reshape(-1, 3).split(CHUNK)
        found = [values.new_empty((0, *values.shape[1:]))]
        for face, weight in zip(faces, weights, strict=True):
            vertex = mesh.faces[face.clamp(min=0).long()].long()
            share = weight.to(values.dtype).reshape(-1, 3, *ones)
            terms = [values[vertex[:, k]] * share[:, k] for k in range(3)]
            found.append(terms[0] + terms[1] + terms[2])
        return torch.cat(found).reshape(*self.faces.shape, *values.shape[1:])

    def of_faces(self, face_values: Any, missing: float = 0) -> Tensor:
        """Values of the faces, at the closest points: labels, materials, normals of faces, ...

        Args:
            face_values: (F,...), an array or a tensor. Gradients flow to them.
            missing: The value for a query point that is not finite.

        Returns:
            (N,...) of their type.

        Raises:
            MeshError: There are not as many as the mesh's faces.
        """
        values, meshes = self._values(face_values, len(self._of_mesh()), "faces")
        if meshes is not None:
            return torch.stack([one.of_faces(own, missing) for one, own in zip(meshes, values, strict=True)])
        ones = [1] * (values.ndim - 1)
        found = [
            values[face.clamp(min=0).long()].masked_fill((face < 0).reshape(-1, *ones), missing)
            for face in self.faces.reshape(-1).split(CHUNK)
        ]
        return torch.cat([values.new_empty((0, *values.shape[1:])), *found]).reshape(
            *self.faces.shape, *values.shape[1:]
        )

    def _of_mesh(self) -> TriangleMesh:
        if self._mesh is None:
            raise MeshError("these closest points were made by hand, without the mesh that has the values")
        return self._mesh

    def _values(self, given: Any, count: int, what: str) -> tuple[Tensor, list[Closest] | None]:
        """The values, and of a batch with values of its own for each mesh the closest points of each."""
        values = torch.as_tensor(given, device=self.points.device)
        if self._batch is not None and values.shape[:2] == (self._batch, count):
            parts = zip(self.points, self.faces, self.barycentric, strict=True)
            return values, [Closest(*part, self._mesh, self._asked) for part in parts]
        if values.ndim == 0 or values.shape[0] != count:
            each = "" if self._batch is None else f" or ({self._batch}, {count}, ...)"
            raise MeshError(
                f"values of shape {tuple(values.shape)} are not one for each of the mesh's {count} {what}; "
                f"({count}, ...){each} is needed"
            )
        return values, None
