"""mesh_to_sdf's three functions: the same calls, by exact distances."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import sdm
from sdm.compat import mesh_to_sdf as ours

BOX = trimesh.creation.box((2, 4, 6), trimesh.transformations.translation_matrix([5, 0, 0]))


def test_points():
    found = ours.mesh_to_sdf(BOX, np.array([[5.0, 0, 0], [8, 0, 0]]), "sample", "depth", device="cpu")
    assert found.dtype == np.float32
    assert found.tolist() == [-1, 2]
    with pytest.raises(sdm.MeshError, match=r"\(N, 3\) is needed"):
        ours.mesh_to_sdf(BOX, np.zeros(3))


def test_voxels():
    voxels = ours.mesh_to_voxels(BOX, 5, device="cpu")
    # Scaled to a half-length of 1 along z: 1/3, 2/3, 1.
    assert voxels.shape == (5, 5, 5)
    np.testing.assert_allclose(voxels[2, 2], [0, -1 / 3, -1 / 3, -1 / 3, 0], atol=1e-6)
    np.testing.assert_allclose(voxels[0, 2, 2], 2 / 3, atol=1e-6)
    padded, slopes = ours.mesh_to_voxels(BOX, 5, pad=True, return_gradients=True, device="cpu")
    np.testing.assert_array_equal(padded[1:-1, 1:-1, 1:-1], voxels)
    assert (padded[0] == 1).all()
    assert slopes.shape == (7, 7, 7, 3)
    np.testing.assert_allclose(slopes[1, 3, 3], [-1, 0, 0], atol=1e-6)
    # From inside the surface is reached along the way out.
    np.testing.assert_allclose(np.abs(slopes[3, 3, 3]), [1, 0, 0], atol=1e-6)


def test_samples():
    points, values = ours.sample_sdf_near_surface(BOX, 1000, seed=0, device="cpu")
    assert (points.dtype, values.dtype) == (np.float32, np.float32)
    assert (points.shape, values.shape) == ((1000, 3), (1000,))
    np.testing.assert_array_equal(values, ours.mesh_to_sdf(ours.scale_to_unit_sphere(BOX), points, device="cpu"))
    assert np.abs(values[470:940]).max() < 0.002 < np.abs(values[:470]).max() < 0.02
    assert np.linalg.norm(points[940:], axis=1).max() <= 1
    again, _, slopes = ours.sample_sdf_near_surface(BOX, 1000, seed=0, return_gradients=True, device="cpu")
    np.testing.assert_array_equal(again, points)
    moved = ours.mesh_to_sdf(ours.scale_to_unit_sphere(BOX), points + 1e-3 * slopes, device="cpu")
    assert np.median(moved - values) == pytest.approx(1e-3, rel=1e-2)
    assert not np.array_equal(ours.sample_sdf_near_surface(BOX, 100, device="cpu")[0][:50], points[:50])


def test_meshes_with_little_inside():
    with pytest.raises(ours.BadMeshException, match=r"less than 0\.9 of the unit sphere is inside"):
        ours.sample_sdf_near_surface(BOX, 1000, min_size=0.9, seed=0, device="cpu")
    with pytest.raises(sdm.MeshError, match="size zero"):
        ours.mesh_to_voxels(sdm.TriangleMesh(np.ones((3, 3)), [[0, 1, 2]]))
