"""Closest points in float64, with the face that looks at the point among those that are equally near."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.engine.points import PointsIndex
from sdm.errors import MeshError, one_line
from sdm.inspect.positions import first_at_position
from sdm.kernels.closest.float64_mesh import Answers, ExactMesh, Known, measure_in_float64
from sdm.runtime.torch_warp import as_warp, on_current_stream
from sdm.topology.face_pairing import pairing_of

# Squared distances that differ by no more than rounding, relative to the mesh's squared size.
ROUNDING = 1e-15


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
        corners = float64_array(vertices, "the vertices")
        # Shapes and values are looked at first.
        whole = TriangleMesh(corners, faces, name)
        low, high = whole.bounds
        self.middle = (low + high) / 2
        self.index = PointsIndex(TriangleMesh(corners - self.middle, whole.faces, name, check=False), device)
        self._vertices = torch.from_numpy(corners - self.middle).to(self.index.device)
        self._near = _neighbours(np.asarray(vertices, np.float32), self.index.mesh.faces)
        self._mesh = ExactMesh()
        self._mesh.vertices = as_warp(self._vertices, wp.vec3d)
        self._mesh.faces = as_warp(self.index.mesh.faces, wp.int32)
        self._mesh.neighbours = as_warp(self._near, wp.int32)
        self._mesh.equal, self._mesh.rounding = equal, ROUNDING * float(((high - low) ** 2).sum())

    def query(self, points: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Signed distances (N,) negative inside, closest points (N,3), both float64, faces (N,) int64, normals (N,3).

        Args:
            points: (N,3) coordinates.

        Raises:
            MeshError: The points are not (N,3).
        """
        at = float64_array(points, "the points")
        if at.ndim != 2 or at.shape[1] != 3:
            raise MeshError(f"the points have shape {at.shape}; (N, 3) is needed")
        moved = torch.from_numpy(at - self.middle).to(self.index.device)
        signed, hit = self.index.signed_distance(moved.float(), return_closest=True)
        count = len(moved)
        distance = moved.new_empty(count)
        closest, normal = torch.empty_like(moved), torch.empty_like(moved)
        face = torch.empty(count, dtype=torch.int64, device=moved.device)
        with on_current_stream(moved, self._vertices, self.index.mesh.faces, self._near):
            known, answers = Known(), Answers()
            known.values, known.faces = as_warp(signed, wp.float32), as_warp(hit.faces, wp.int32)
            known.barycentric = as_warp(hit.barycentric, wp.vec3)
            answers.distances, answers.faces = as_warp(distance, wp.float64), as_warp(face, wp.int64)
            answers.points, answers.normals = as_warp(closest, wp.vec3d), as_warp(normal, wp.vec3d)
            measure_in_float64(self._mesh, as_warp(moved, wp.vec3d), known, answers)
        where = closest.cpu().numpy() + self.middle
        return distance.cpu().numpy(), where, face.cpu().numpy(), normal.cpu().numpy()


def _neighbours(vertices: np.ndarray, faces: Tensor) -> Tensor:
    """For each face one at each of its edges (F, 3 or more) int32, as 3 * face + edge, on the device; -1 for none."""
    pairing = pairing_of(faces, len(vertices))
    if not len(pairing.unmatched):
        # Closed without merging vertices at one place: what the index has found already.
        return pairing.neighbours
    first = first_at_position(vertices)
    return torch.from_numpy(_around_edges(first[faces.cpu().numpy()])).to(faces.device)


def _around_edges(corners: np.ndarray) -> np.ndarray:
    """The same of faces by their corners (F,3): the next face around each edge, itself where there is none."""
    edges = np.sort(np.stack([corners, np.roll(corners, -1, 1)], -1), -1).reshape(-1, 2).astype(np.int64)
    key = edges[:, 0] * (int(corners.max()) + 1) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    # The next face around the edge, and after the last the first.
    group = np.flatnonzero(np.diff(key[order], prepend=-1))
    following = np.arange(1, len(order) + 1)
    following[np.append(group[1:], len(order)) - 1] = group
    near = np.empty(len(order), np.int32)
    near[order] = order[following]
    return near.reshape(-1, 3)


def float64_array(values: Any, what: str) -> np.ndarray:
    """An array of float64 of whatever NumPy takes for one.

    Raises:
        MeshError: It holds something else than numbers.
    """
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MeshError(f"{what} are no array of numbers: {one_line(error)}") from error
