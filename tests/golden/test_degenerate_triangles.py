"""Triangles that are segments or points, and needles: every one of them counts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import sdm
from sdm.bench.common.meshes import cube

# From the segment (0,0,0)-(4,0,0).
SEGMENT = [([2, 3, 4], 5), ([-3, 4, 0], 5), ([7, 0, 4], 5), ([1, 0, 0], 0), ([4, 0, 0], 0), ([3, -5, 12], 13)]
SHAPES = {
    "second corner twice": [[0, 0, 0], [4, 0, 0], [4, 0, 0]],
    "first corner twice": [[0, 0, 0], [0, 0, 0], [4, 0, 0]],
    "corner in the middle": [[0, 0, 0], [4, 0, 0], [2, 0, 0]],
    "corner off the middle": [[0, 0, 0], [4, 0, 0], [0.3, 0, 0]],
}


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
@pytest.mark.parametrize("shape", SHAPES.values(), ids=list(SHAPES))
def test_segments(shape, order):
    mesh = sdm.TriangleMesh(np.array(shape, np.float32)[list(order)], [[0, 1, 2]])
    points = np.array([point for point, _ in SEGMENT], np.float32)
    values, hit = sdm.signed_distance(mesh, points, return_closest=True, device="cpu")
    assert values.tolist() == [distance for _, distance in SEGMENT]
    np.testing.assert_allclose(hit.points[:, 0], np.clip(points[:, 0], 0, 4), atol=1e-6)
    assert (hit.points[:, 1:] == 0).all()
    assert sdm.MeshIndex(mesh, "cpu").winding_number(points[:3]).tolist() == [0, 0, 0]


@pytest.mark.parametrize("index", [[0, 0, 0], [0, 1, 2]])
def test_points(index):
    mesh = sdm.TriangleMesh([[1, 2, 3]] * 3, [index])
    values, hit = sdm.signed_distance(mesh, [[1, 2, 3], [4, 6, 15], [1, 2, -7]], return_closest=True, device="cpu")
    assert values.tolist() == [0, 13, 10]
    assert hit.points.tolist() == [[1, 2, 3]] * 3
    field = sdm.signed_distance_map(mesh, sdm.Grid([1, 2, 0], [1, 1, 3], [1, 1, 2]), device="cpu")
    assert field.values.tolist() == [[[3, 0]]]


@pytest.mark.parametrize("height", [1e-3, 1e-6, 1e-9, 1e-12])
def test_needles(height):
    """A million times longer than high and more: the height over its plane is as exact as over any triangle."""
    mesh = sdm.TriangleMesh([[0, 0, 0], [1, 0, 0], [0.5, height, 0]], [[0, 1, 2]])
    values = sdm.signed_distance(mesh, [[0.5, 0.5 * height, 3], [0.5, -4, 3], [-3, 0, 4], [0.25, 0, 0.5]], device="cpu")
    np.testing.assert_allclose(values, [3, 5, 5, 0.5], rtol=0, atol=1e-6)


def test_a_needle_far_along_its_tilted_plane():
    """Corners 1,000 away, a point 1e-3 above: float32 normals of needles would be off by far more."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    corner = (np.array([[-1000, 0, 0], [1000, 0, 0], [900, 1e-2, 0]]) @ turn).astype(np.float32)
    normal = np.cross(*(corner[1:].astype(float) - corner[0]))
    inside = np.array([0.3, 0.3, 0.4]) @ corner
    point = inside + 1e-3 * normal / np.linalg.norm(normal)
    value = float(sdm.signed_distance(sdm.TriangleMesh(corner, [[0, 1, 2]]), point, device="cpu"))
    assert abs(value - 1e-3) < 4 * 2**-24 * 1000


def test_beside_a_solid():
    """A stray segment shortens distances and changes no sign."""
    vertices, faces = cube()
    vertices = np.concatenate([vertices, [[5, 0, 0], [5, 3, 0], [0, 0.5, 0]]])
    mesh = sdm.TriangleMesh(vertices, np.concatenate([faces, [[8, 9, 9], [10, 10, 10]]]))
    index = sdm.MeshIndex(mesh, "cpu")
    assert index.closed
    assert index.signed_distance([[5, 1, 2.0], [4.5, 2, 0], [0, 0, 0], [0, 0.25, 0], [3, 0, 0]]).tolist() == [
        2,
        0.5,
        -0.5,
        -0.25,
        2,
    ]
