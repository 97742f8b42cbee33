"""Rays along x through corners, edges and faces: the integer crossings have no luck to rely on."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import sdm
from sdm.bench.common.meshes import cube, sphere, torus
from tests.helpers.exactness import assert_exact, assert_winding

turns = list(itertools.permutations(range(3)))


def _behind(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Points whose y and z are those of a vertex, of an edge's middle, of a face's middle or of a bit beside it."""
    corner = vertices[faces]
    middle = (0.5 * (corner + np.roll(corner, 1, 1))).reshape(-1, 3)
    targets = np.unique(np.concatenate([vertices, middle, corner.mean(1)]), axis=0)
    rows = []
    for x in (-3.0, -1.0, -0.75, -0.25, 0.0, 0.5, 1.0, 1.5):
        behind = targets.copy()
        behind[:, 0] = x
        rows += [behind + np.array([0, step, -step], np.float32) for step in (0, 1e-12, -1e-9, 1e-7)]
    return np.concatenate(rows).astype(np.float32)


@pytest.mark.parametrize("order", turns)
@pytest.mark.parametrize("missing", [0, 1, 3])
def test_cube(order, missing):
    """Closed, without one triangle, without three."""
    vertices, faces = cube()
    vertices = np.ascontiguousarray(vertices[:, order])
    if order in turns[1::2] and missing == 3:
        faces = faces[::-1]
    faces = faces[missing:]
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu")
    assert index.closed == (missing == 0)
    points = _behind(vertices, faces)
    assert_exact(vertices, faces, points, index.signed_distance(points))
    assert_winding(vertices, faces, points, index.winding_number(points))


@pytest.mark.parametrize("missing", [0, 7])
@pytest.mark.parametrize("make", [lambda: sphere(5), lambda: torus(144)], ids=["sphere", "torus"])
def test_round_shapes(make, missing):
    vertices, faces = make()
    faces = faces[missing:]
    points = _behind(vertices, faces)
    points = points[np.random.default_rng(0).permutation(len(points))[:4000]]
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu")
    assert_exact(vertices, faces, points, index.signed_distance(points))
    assert_winding(vertices, faces, points, index.winding_number(points))


def test_far_beside_an_open_mesh():
    """Beyond the lattice of the mesh's own box the boundary's angles still have their signs."""
    vertices, faces = cube()
    faces = faces[:-2]
    rng = np.random.default_rng(1)
    points = (rng.normal(size=(2000, 3)) * 10.0 ** rng.uniform(0, 5, (2000, 3))).astype(np.float32)
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu")
    assert_winding(vertices, faces, points, index.winding_number(points))
