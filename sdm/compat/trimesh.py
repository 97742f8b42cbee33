"""trimesh.proximity: `signed_distance`, `closest_point`, `ProximityQuery`. Positive inside, float64, int64 faces."""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
import torch

from sdm.compat.closest_in_float64 import ClosestInFloat64
from sdm.core.as_mesh import as_mesh

# Within this of the surface a point counts as inside, and squared distances that differ by no more than this share are
# equal: trimesh's `tol.merge`.
MERGE = 1e-8
# Indexes of the meshes that were asked last, each with the mesh and its contents' hash.
_MOST = 4
_known: list[tuple[weakref.ref[Any], int, str, ClosestInFloat64]] = []


def closest_point(
    mesh: Any, points: Any, *, device: str | torch.device | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The closest points of a mesh: of those equally near the one on the face whose front looks at the point.

    Args:
        mesh: A `trimesh.Trimesh`, or whatever `sdm.core.as_mesh` takes for a mesh.
        points: (N,3).
        device: Where to compute; by default a GPU if there is one.

    Returns:
        Closest points (N,3) float64, distances (N,) float64 of at least 0, faces (N,) int64.
    """
    distance, closest, face, _ = _queries(mesh, device).query(points)
    return closest, np.abs(distance), face


def signed_distance(mesh: Any, points: Any, *, device: str | torch.device | None = None) -> np.ndarray:
    """Signed distances (N,) float64 of points (N,3): positive inside and within 1e-8 of the surface.

    Inside is where the generalised winding number is above 0.5, which needs faces that look outward.
    """
    distance, _, _, _ = _queries(mesh, device).query(points)
    return np.where(np.abs(distance) <= MERGE, np.abs(distance), -distance)


class ProximityQuery:
    """`trimesh.proximity.ProximityQuery`: what `mesh.nearest` is, for a mesh that may change in between.

    Args:
        mesh: A `trimesh.Trimesh`, or whatever `sdm.core.as_mesh` takes for a mesh.
        device: Where to compute; by default a GPU if there is one.
    """

    def __init__(self, mesh: Any, *, device: str | torch.device | None = None) -> None:
        self._mesh, self._device = mesh, device

    def on_surface(self, points: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `closest_point`."""
        return closest_point(self._mesh, points, device=self._device)

    def signed_distance(self, points: Any) -> np.ndarray:
        """As `signed_distance`."""
        return signed_distance(self._mesh, points, device=self._device)

    def vertex(self, points: Any) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) of points (N,3) to the nearest vertices, and their numbers (N,)."""
        from scipy.spatial import KDTree

        distance, vertex = KDTree(_arrays(self._mesh)[0]).query(np.asarray(points, dtype=np.float64))
        return np.asarray(distance), np.asarray(vertex)


def _arrays(mesh: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V,3) float64, as many digits as the mesh has, and faces (F,3)."""
    if not isinstance(mesh, str | tuple | list) and hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        vertices, faces = mesh.vertices, mesh.faces
        if isinstance(vertices, np.ndarray):
            return np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    vertices, faces = as_mesh(mesh).numpy()
    return vertices.astype(np.float64), faces


def _queries(mesh: Any, device: str | torch.device | None) -> ClosestInFloat64:
    """The index of a mesh: kept while its contents have the same hash, as a `trimesh.Trimesh` has one."""
    name = str(device)
    kept = type(mesh).__module__.partition(".")[0] == "trimesh" and hasattr(mesh, "faces")
    digest = hash(mesh) if kept else 0
    for known, contents, where, index in _known:
        if kept and known() is mesh and contents == digest and where == name:
            return index
    index = ClosestInFloat64(*_arrays(mesh), device, equal=MERGE)
    if kept:
        _known.insert(0, (weakref.ref(mesh), digest, name, index))
        del _known[_MOST:]
    return index
