"""Open3D's RaycastingScene: its calls about distances, on several meshes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import sdm
from sdm.compat.open3d import RaycastingScene

BALL = trimesh.creation.icosphere(2)
BOX = trimesh.creation.box((1, 1, 1), trimesh.transformations.translation_matrix([3, 0, 0]))
POINTS = np.random.default_rng(0).uniform(-2, 4, (4, 50, 3)).astype(np.float32)


def scene() -> RaycastingScene:
    made = RaycastingScene(device="cpu")
    assert made.add_triangles(BALL) == 0
    assert made.add_triangles(np.asarray(BOX.vertices, np.float32), np.asarray(BOX.faces, np.uint32)) == 1
    return made


def test_distances():
    both = trimesh.util.concatenate([BALL, BOX])
    wanted = sdm.signed_distance(both, POINTS, device="cpu").numpy()
    made = scene()
    found = made.compute_signed_distance(POINTS)
    assert (found.dtype, found.shape) == (np.float32, (4, 50))
    np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(made.compute_distance(POINTS), np.abs(wanted))
    np.testing.assert_array_equal(made.compute_occupancy(POINTS), (wanted < 0).astype(np.float32))


def test_closest_points():
    found = scene().compute_closest_points(POINTS)
    assert found["primitive_ids"].dtype == found["geometry_ids"].dtype == np.uint32
    assert set(np.unique(found["geometry_ids"])) == {0, 1}
    for number, mesh in enumerate((BALL, BOX)):
        mine = found["geometry_ids"] == number
        corners = mesh.triangles[found["primitive_ids"][mine]]
        u, v = found["primitive_uvs"][mine].T
        at = corners[:, 0] * (1 - u - v)[:, None] + corners[:, 1] * u[:, None] + corners[:, 2] * v[:, None]
        np.testing.assert_allclose(at, found["points"][mine], atol=1e-6)
        normals = mesh.face_normals[found["primitive_ids"][mine]]
        np.testing.assert_allclose(found["primitive_normals"][mine], normals, atol=1e-5)


def test_meshes_may_be_added_later():
    made = RaycastingScene(device="cpu")
    with pytest.raises(sdm.MeshError, match="the scene is empty"):
        made.compute_distance([[0.0, 0, 0]])
    made.add_triangles(BALL)
    far = made.compute_distance([[3.0, 0, 0]])
    made.add_triangles(BOX)
    assert made.compute_distance([[3.0, 0, 0]]) < far


def test_equals_open3d():
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    theirs = open3d.t.geometry.RaycastingScene()
    for mesh in (BALL, BOX):
        arrays = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
        theirs.add_triangles(*(open3d.core.Tensor(array) for array in arrays))
    at = open3d.core.Tensor(POINTS)
    found = scene()
    for name in ("compute_distance", "compute_signed_distance", "compute_occupancy"):
        answer = getattr(found, name)(at)
        assert isinstance(answer, open3d.core.Tensor)
        np.testing.assert_allclose(answer.numpy(), getattr(theirs, name)(at).numpy(), atol=1e-5)
    other, mine = theirs.compute_closest_points(at), found.compute_closest_points(at)
    for name in ("points", "geometry_ids"):
        np.testing.assert_allclose(mine[name].numpy(), other[name].numpy(), atol=1e-5)
    assert set(mine) == set(other)
