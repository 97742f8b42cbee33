"""Closest points, their faces and barycentric coordinates tell one story, and it is the brute force's."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from tests.helpers import oracle, strategies
from tests.helpers.exactness import ROUNDING, scale_of

meshes = st.one_of(strategies.soups(), strategies.slivers(), strategies.closed())


@settings(max_examples=40)
@given(strategies.anywhere(meshes), strategies.seeds)
def test_closest_points(mesh, seed):
    points = strategies.points_about(mesh, seed, 32)
    values, hit = sdm.signed_distance(sdm.TriangleMesh(*mesh), points, return_closest=True, device="cpu")
    scale = scale_of(mesh.vertices, mesh.faces, points)
    closest = hit.points.double().numpy()
    face, weights = hit.faces.numpy(), hit.barycentric.double().numpy()

    assert ((face >= 0) & (face < len(mesh.faces))).all()
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(1), 1, atol=4e-7)
    corner = mesh.vertices[mesh.faces[face]].astype(np.float64)
    from_weights = (weights[:, None] @ corner)[:, 0]
    assert (np.abs(from_weights - closest).max(1) <= 4 * ROUNDING * scale).all()

    reach = np.linalg.norm(points - closest, axis=1)
    assert (np.abs(reach - values.abs().double().numpy()) <= 6 * ROUNDING * scale).all()
    expected, _, _ = oracle.distance(mesh.vertices, mesh.faces, points)
    assert (np.abs(reach - expected) <= 6 * ROUNDING * scale).all()


@given(strategies.anywhere(meshes), strategies.seeds)
@settings(max_examples=20)
def test_the_closest_point_changes_nothing_else(mesh, seed):
    points = strategies.points_about(mesh, seed, 16)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    alone = index.signed_distance(points)
    beside, _ = index.signed_distance(points, return_closest=True)
    assert (alone == beside).all()
