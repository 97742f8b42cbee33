"""Thousands of triangles at nearly the same distance: whichever is chosen, the distance is that of the nearest."""

from __future__ import annotations

import numpy as np
import pytest

import sdm
from sdm.bench.common.meshes import sphere
from tests.helpers.exactness import assert_exact


@pytest.mark.parametrize("off", [0.0, 1e-7, 1e-5, 1e-3])
def test_at_the_centre_of_a_sphere(off):
    vertices, faces = sphere(24)
    rng = np.random.default_rng(5)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    vertices = (vertices @ turn).astype(np.float32)
    points = (off * rng.normal(size=(200, 3))).astype(np.float32)
    assert_exact(vertices, faces, points, sdm.signed_distance(sdm.TriangleMesh(vertices, faces), points, device="cpu"))


@pytest.mark.parametrize("reach", [10.0, 1e3, 1e6])
def test_far_from_a_sphere(reach):
    vertices, faces = sphere(16)
    rng = np.random.default_rng(6)
    points = (reach * rng.normal(size=(200, 3))).astype(np.float32)
    assert_exact(vertices, faces, points, sdm.signed_distance(sdm.TriangleMesh(vertices, faces), points, device="cpu"))


def test_stacked_sheets():
    """Large triangles a few roundings above each other: their heights decide, not their corners."""
    rng = np.random.default_rng(7)
    corner = rng.normal(size=(60, 3, 3))
    corner[:, :, 2] = 1e-3 + 1e-7 * rng.normal(size=(60, 1))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    points = np.concatenate([rng.normal(size=(300, 2)), np.zeros((300, 1))], 1) @ turn
    vertices = (corner @ turn).reshape(-1, 3).astype(np.float32)
    faces = np.arange(180).reshape(-1, 3)
    values = sdm.signed_distance(sdm.TriangleMesh(vertices, faces), points, device="cpu")
    assert_exact(vertices, faces, points.astype(np.float32), values)
