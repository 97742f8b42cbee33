"""trimesh.proximity's functions: its signs and types, float64, and the face that looks at the point."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import sdm
from sdm.compat import trimesh as ours
from sdm.compat.closest_in_float64 import ClosestInFloat64
from tests.helpers import oracle

BALL = trimesh.creation.icosphere(2)
POINTS = np.random.default_rng(0).uniform(-1.5, 1.5, (300, 3))


def test_signs_types_and_digits():
    offsets = oracle.closest_on_triangles(POINTS[:, None], np.array(BALL.triangles)[None])
    nearest = np.linalg.norm(offsets, axis=-1).min(1)
    closest, distance, found = ours.closest_point(BALL, POINTS, device="cpu")
    assert (closest.dtype, distance.dtype, found.dtype) == (np.float64, np.float64, np.int64)
    # Beyond float32's digits.
    np.testing.assert_allclose(distance, nearest, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(closest - POINTS, axis=1), distance, atol=1e-12)
    on = POINTS - oracle.closest_on_triangles(POINTS, np.array(BALL.triangles[found]))
    np.testing.assert_allclose(closest, on, atol=1e-12)
    signed = ours.signed_distance(BALL, POINTS, device="cpu")
    np.testing.assert_array_equal(signed > 0, BALL.contains(POINTS) if trimesh.util.has_module("rtree") else signed > 0)
    np.testing.assert_allclose(np.abs(signed), distance)
    assert (signed[np.linalg.norm(POINTS, axis=1) < 0.9] > 0).all()
    assert (signed[np.linalg.norm(POINTS, axis=1) > 1] < 0).all()


def test_far_from_the_origin_no_digits_are_lost():
    far = BALL.copy()
    far.apply_translation([1e5, -1e5, 0])
    near, moved = ours.signed_distance(BALL, POINTS, device="cpu"), np.add(POINTS, (1e5, -1e5, 0))
    np.testing.assert_allclose(ours.signed_distance(far, moved, device="cpu"), near, atol=1e-9)


def test_the_face_that_looks_at_the_point():
    # A sharp edge along x at z = 0: of the two faces there each looks at one half of the points beyond it.
    wedge = trimesh.Trimesh(
        [[-1, 0.5, 0], [1, 0.5, 0], [0, -1, -0.5], [0, -1, 0.5]], [[0, 1, 2], [0, 2, 3], [0, 3, 1], [3, 2, 1]]
    )
    points = np.column_stack([np.zeros(10), np.ones(10), np.linspace(-1, 1, 10)])
    _, _, face = ours.closest_point(wedge, points, device="cpu")
    assert (face[:5] == face[0]).all()
    assert (face[5:] == face[9]).all()
    assert face[0] != face[9]
    looks = (wedge.face_normals[face] * (points - [0, 0.5, 0])).sum(1)
    assert (looks > 0).all()


def test_equally_near_faces_whose_closest_points_differ():
    # Nearer to the first, whose back looks at the point, by a rounding.
    corner = trimesh.Trimesh([[0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, -1]], [[0, 1, 2], [0, 1, 3]], process=False)
    closest, _, face = ours.closest_point(corner, [[-0.25 - 1e-9, 0, -0.25]], device="cpu")
    assert face.tolist() == [1]
    np.testing.assert_allclose(closest[0], [0, 0, -0.25])


def test_points_on_the_surface_count_as_inside():
    on = BALL.triangles_center
    distance = ours.signed_distance(BALL, on, device="cpu")
    assert (distance >= 0).all()
    assert distance.max() < 1e-8


def test_a_mesh_that_changes_is_built_anew():
    mesh = BALL.copy()
    query = ours.ProximityQuery(mesh, device="cpu")
    before = query.signed_distance([[2.0, 0, 0]])
    known = ours._queries(mesh, "cpu")
    assert ours._queries(mesh, "cpu") is known
    mesh.apply_scale(1.5)
    np.testing.assert_allclose(query.signed_distance([[2.0, 0, 0]]), before + 0.5)
    assert ours._queries(mesh, "cpu") is not known


def test_query():
    query = ours.ProximityQuery(BALL, device="cpu")
    distance, vertex = query.vertex(POINTS)
    np.testing.assert_allclose(np.linalg.norm(BALL.vertices[vertex] - POINTS, axis=1), distance)
    assert [len(part) for part in query.on_surface(POINTS[:7])] == [7, 7, 7]
    assert query.signed_distance(np.zeros((0, 3))).shape == (0,)
    with pytest.raises(sdm.MeshError, match=r"shape \(2, 2\); \(N, 3\) is needed"):
        query.signed_distance(np.zeros((2, 2)))


def test_other_meshes_go_in():
    pair = np.asarray(BALL.vertices), np.asarray(BALL.faces)
    wanted = ours.signed_distance(BALL, POINTS, device="cpu")
    np.testing.assert_allclose(ours.signed_distance(pair, POINTS, device="cpu"), wanted, atol=1e-6)


def test_degenerate_triangles():
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [1, 0, 0], [0, 0, 5]])
    thin = ClosestInFloat64(corners, [[0, 1, 2], [3, 3, 3]], "cpu")
    distance, _, face, normal = thin.query([[1.5, 1, 0], [0, 0, 6]])
    np.testing.assert_allclose(np.abs(distance), 1)
    assert face.tolist() == [0, 1]
    assert (normal == 0).all()
