"""Edges that bound a corner's Voronoi region: its own, those of the triangles next to it, and one more."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false, reportOperatorIssue=false

from __future__ import annotations

import numpy as np
import torch
import warp as wp
from hypothesis import given, settings

from sdm.bench.common.meshes import sphere
from sdm.kernels.culling.voronoi_features import end_of_further_edge
from sdm.topology.face_pairing import neighbours
from tests.helpers import strategies

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _ends(faces: wp.array2d(dtype=wp.int32), around: wp.array2d(dtype=wp.int32), out: wp.array2d(dtype=wp.int32)):
    face = wp.tid()
    for k in range(3):
        out[face, k] = end_of_further_edge(faces, around, faces[face, k], around[face, k])


def ends(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,3) the end of the further edge of each corner, or -1."""
    around = neighbours(torch.tensor(faces), len(vertices)).numpy()
    out = wp.zeros(faces.shape, dtype=wp.int32, device="cpu")
    given = [wp.array(np.ascontiguousarray(a), dtype=wp.int32, ndim=2, device="cpu") for a in (faces, around)]
    wp.launch(_ends, len(faces), [*given, out], device="cpu")
    return out.numpy()


@settings(max_examples=50)
@given(strategies.soups())
def test_a_further_edge_is_one_of_the_mesh(mesh):
    edges = {frozenset((f[k], f[(k + 1) % 3])) for f in mesh.faces.tolist() for k in range(3)}
    corners = {frozenset((v,)) for v in range(len(mesh.vertices))}
    for face, found in zip(mesh.faces.tolist(), ends(mesh.vertices, mesh.faces).tolist(), strict=True):
        for k in range(3):
            assert found[k] < 0 or frozenset((face[k], found[k])) in edges | corners


def test_of_a_closed_mesh_it_is_the_next_one_around_the_corner():
    vertices, faces = sphere(8)
    of_edge = {(f[k], f[(k + 1) % 3]): f[(k + 2) % 3] for f in faces.tolist() for k in range(3)}
    for face, found in zip(faces.tolist(), ends(vertices, faces).tolist(), strict=True):
        for k in range(3):
            # Over the edge to the next corner there is a triangle, and over its other edge from here another.
            beyond = of_edge[face[(k + 1) % 3], face[k]]
            assert found[k] == of_edge[beyond, face[k]]
