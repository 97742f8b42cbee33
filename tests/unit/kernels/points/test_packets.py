"""Neighbouring points share what is known of their surroundings; that must not show in any answer."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere
from sdm.kernels.points.query import PACKET
from tests.helpers.oracle import distance, winding_number


def bowl(holes: int) -> sdm.TriangleMesh:
    """A sphere of radius 1 with `holes` triangles missing around the pole z = 1."""
    vertices, faces = sphere(12)
    height = vertices[faces].mean(1)[:, 2]
    return sdm.TriangleMesh(vertices.astype(np.float32), faces[np.argsort(height)[: len(faces) - holes]])


def clouds(rng: np.random.Generator, count: int) -> np.ndarray:
    """Small clouds of points: in the hole, under it, on the far side, inside and outside, and far away."""
    centres = np.array([[0, 0, 1], [0, 0, 0.8], [0, 0, -1], [0, 0, 0], [0.9, 0, 0], [1.2, 0, 0.2], [0, 0, 40]])
    chosen = centres[rng.integers(0, len(centres), count)]
    return (chosen + 0.15 * rng.normal(size=(count, 3))).astype(np.float32)


@pytest.mark.parametrize("holes", [0, 1, 40])
@pytest.mark.parametrize("count", [3, PACKET + 1, 5_000])
def test_signs_are_those_of_the_winding_number(holes: int, count: int) -> None:
    mesh = bowl(holes)
    points = clouds(np.random.default_rng(count), count)
    index = sdm.MeshIndex(mesh, "cpu")
    assert index.closed == (holes == 0)
    values = index.signed_distance(points)
    winding = index.winding_number(points)
    # Where the winding number is 0.5 to rounding, either side will do.
    clear = (winding - 0.5).abs() > 1e-6
    assert torch.equal((values < 0)[clear], (winding > 0.5)[clear])


def test_a_group_of_points_far_apart() -> None:
    mesh = bowl(40)
    points = np.random.default_rng(0).uniform(-3, 3, (PACKET, 3)).astype(np.float32)
    points[3] = np.nan
    points[7] = [1e30, -1e30, 1e30]
    values = sdm.MeshIndex(mesh, "cpu").signed_distance(points).numpy()
    assert np.isnan(values[3])
    ordinary = [i for i in range(PACKET) if i not in (3, 7)]
    vertices, faces = mesh.numpy()
    inside = winding_number(vertices, faces, points[ordinary]) > 0.5
    expected = distance(vertices, faces, points[ordinary])[0] * (1 - 2 * inside)
    np.testing.assert_allclose(values[ordinary], expected, rtol=0, atol=4 * 3 * 2**-24)


def test_only_points_that_are_not_finite() -> None:
    values = sdm.MeshIndex(bowl(1), "cpu").signed_distance(np.full((5, 3), np.inf, np.float32))
    assert bool(values.isnan().all())
