"""Checks of a closed surface: counts of edges both ways, vertices at places of their own, areas."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sdm.core.mesh import TriangleMesh


def areas_and_volume(mesh: TriangleMesh) -> tuple[np.ndarray, float]:
    """Areas (F,) and the signed volume, in float64."""
    vertices, faces = mesh.numpy()
    a, b, c = np.moveaxis(vertices.astype(np.float64)[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    return np.linalg.norm(normals, axis=1) / 2, float((a * normals).sum() / 6)


def assert_closed_manifold(mesh: TriangleMesh) -> None:
    """Each edge once each way, one fan of faces at each vertex, no two vertices in one place, volume and areas."""
    vertices, faces = mesh.numpy()
    assert_edges_cancel(faces, len(vertices))
    assert len(np.unique(faces)) == len(vertices)
    assert len(np.unique(vertices, axis=0)) == len(vertices)
    areas, volume = areas_and_volume(mesh)
    assert areas.min() > 0
    assert volume > 0


def assert_edges_cancel(faces: np.ndarray, vertices: int) -> None:
    """Each directed edge is there once, and the other way once; each vertex has one fan."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    keys = edges[:, 0] * vertices + edges[:, 1]
    forth, uses = np.unique(keys, return_counts=True)
    assert uses.max() == 1
    np.testing.assert_array_equal(forth, np.unique(edges[:, 1] * vertices + edges[:, 0]))
    # The edge that follows another around a vertex, in the face between them: one cycle for each vertex, or there is
    # more than one fan.
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]]).astype(np.int64)
    place, following = (np.searchsorted(forth, key) for key in (keys, edges[:, 0] * vertices + opposite))
    ring = coo_array((np.ones(len(place)), (place, following)))
    assert connected_components(ring)[0] == len(np.unique(edges[:, 0]))
