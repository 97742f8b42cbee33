"""open3d.t.geometry.RaycastingScene: its calls about distances. Negative inside, float32."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import torch

from sdm.core.as_mesh import as_mesh
from sdm.core.mesh import TriangleMesh
from sdm.engine.points import PointsIndex
from sdm.errors import MeshError


class RaycastingScene:
    """A scene of triangle meshes to measure distances to; rays are not among its calls.

    Args:
        nthreads: Taken and not used.
        device: Where to compute; by default a GPU if there is one.

    Points are (...,3) in any array; an `open3d.core.Tensor` is answered by such tensors, all else by NumPy arrays.
    """

    INVALID_ID = 0xFFFFFFFF

    def __init__(self, nthreads: int = 0, device: str | torch.device | None = None) -> None:
        self._device = device
        self._meshes: list[TriangleMesh] = []
        self._built: PointsIndex | None = None

    def add_triangles(self, vertices: Any, triangles: Any = None) -> int:
        """Add a mesh, from vertices (V,3) and triangles (F,3) or from any mesh; returns its number in the scene."""
        if triangles is None:
            mesh = as_mesh(vertices)
        else:
            mesh = TriangleMesh(_array(vertices), _array(triangles).astype(np.int64))
        self._meshes.append(mesh)
        self._built = None
        return len(self._meshes) - 1

    def compute_distance(self, query_points: Any, nthreads: int = 0) -> Any:
        """Unsigned distances (...) float32."""
        found = self._index().signed_distance(_array(query_points), sign="none")
        return _as_given(found, query_points)

    def compute_signed_distance(self, query_points: Any, nthreads: int = 0, nsamples: int = 1) -> Any:
        """Signed distances (...) float32, negative inside, by the winding number of all meshes: one sample decides."""
        return _as_given(self._index().signed_distance(_array(query_points)), query_points)

    def compute_occupancy(self, query_points: Any, nthreads: int = 0, nsamples: int = 1) -> Any:
        """1 inside, 0 outside (...), float32."""
        inside = self._index().signed_distance(_array(query_points)) < 0
        return _as_given(inside.float(), query_points)

    def compute_closest_points(self, query_points: Any, nthreads: int = 0) -> dict[str, Any]:
        """Closest points, as a dictionary.

        Returns:
            `points` (...,3); `geometry_ids` and `primitive_ids` (...), uint32, the mesh and its triangle;
            `primitive_uvs` (...,2), the weights of its second and third corner; `primitive_normals` (...,3), unit.
        """
        index = self._index()
        _, hit = index.signed_distance(_array(query_points), return_closest=True, sign="none")
        begins = torch.tensor([0, *np.cumsum([len(mesh) for mesh in self._meshes])], device=index.device)
        face = hit.faces.long()
        number = torch.searchsorted(begins, face, right=True) - 1
        a, b, c = index.mesh.vertices[index.mesh.faces.long()[face]].unbind(-2)
        normal = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=-1, eps=1e-30)
        found = {
            "points": hit.points,
            "geometry_ids": number,
            "primitive_ids": face - begins[number],
            "primitive_uvs": hit.barycentric[..., 1:],
            "primitive_normals": normal,
        }
        return {name: _as_given(values, query_points) for name, values in found.items()}

    def _index(self) -> PointsIndex:
        if not self._meshes:
            raise MeshError("the scene is empty: add a mesh first (add_triangles)")
        if self._built is None:
            whole = self._meshes[0] if len(self._meshes) == 1 else self._together()
            self._built = PointsIndex(whole, self._device)
        return self._built

    def _together(self) -> TriangleMesh:
        begins = np.cumsum([0, *(len(mesh.vertices) for mesh in self._meshes)])
        vertices, faces = zip(*(mesh.numpy() for mesh in self._meshes), strict=True)
        shifted = [part + begin for part, begin in zip(faces, begins, strict=False)]
        return TriangleMesh(np.concatenate(vertices), np.concatenate(shifted), "the scene", check=False)


def _is_open3d(values: Any) -> bool:
    return type(values).__module__.startswith("open3d")


def _array(values: Any) -> Any:
    # Its tensors give arrays by a method, and no DLPack before 0.18.
    return values.cpu().numpy() if _is_open3d(values) else np.asarray(values)


def _as_given(found: torch.Tensor, points: Any) -> Any:
    array = found.detach().cpu().numpy()
    if array.dtype == np.int64:
        array = array.astype(np.uint32)
    return import_module("open3d").core.Tensor(array) if _is_open3d(points) else array
