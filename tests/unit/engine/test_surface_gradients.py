"""On the surface the gradient is the face's normal, and close to it no noise."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube, sphere


def _gradient(mesh: sdm.TriangleMesh, points: np.ndarray) -> np.ndarray:
    at = torch.tensor(points, dtype=torch.float32, requires_grad=True)
    sdm.signed_distance(mesh, at, device="cpu").sum().backward()
    assert at.grad is not None
    return at.grad.numpy()


def test_on_the_sides_of_a_cube():
    points = np.concatenate([np.eye(3), -np.eye(3)]) + 0.25 * np.roll(np.eye(3), 1, 0)[[0, 1, 2, 0, 1, 2]]
    expected = np.concatenate([np.eye(3), -np.eye(3)])
    np.testing.assert_array_equal(_gradient(sdm.TriangleMesh(*cube()), points), expected)


@pytest.mark.parametrize("height", [0, 1e-8, 1e-7, -1e-7, 1e-6, -1e-6, 1e-5, -1e-4])
def test_close_to_a_sphere(height):
    """A few roundings off the surface the difference of points is noise; the gradient must not be."""
    vertices, faces = sphere(10)
    rng = np.random.default_rng(3)
    corner = vertices[faces].astype(np.float64)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    weights = rng.dirichlet([4, 4, 4], len(faces))
    points = (weights[:, None] @ corner)[:, 0] + height * normal
    found = _gradient(sdm.TriangleMesh(vertices, faces), points)
    # 1e-6 above the surface a float32 point near 1 is known to 6 %.
    np.testing.assert_allclose(found, normal, atol=0.15)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-5)


def test_on_an_edge_it_is_one_of_the_two_normals():
    found = _gradient(sdm.TriangleMesh(*cube()), np.array([[1, 1, 0.25], [-1, 0.5, -1]]))
    assert found[0].tolist() in ([1, 0, 0], [0, 1, 0])
    assert found[1].tolist() in ([-1, 0, 0], [0, 0, -1])


def test_on_a_segment_there_is_none():
    """A face without area has no normal: the gradient is zero, not NaN."""
    mesh = sdm.TriangleMesh([[0, 0, 0], [1, 0, 0]], [[0, 1, 1]])
    found = _gradient(mesh, np.array([[0.5, 0, 0], [0, 0, 0], [0.5, 2, 0]]))
    assert found.tolist() == [[0, 0, 0], [0, 0, 0], [0, 1, 0]]


def test_vertices_move_with_the_normal():
    leaf = torch.tensor(cube()[0], requires_grad=True)
    sdm.signed_distance(sdm.TriangleMesh(leaf, cube()[1]), [[1, 0.5, 0.25]], device="cpu").sum().backward()
    assert leaf.grad is not None
    torch.testing.assert_close(leaf.grad.sum(0), torch.tensor([-1.0, 0, 0]))
    assert (leaf.grad[:, 0] <= 0).all()
    assert (leaf.grad[leaf.detach()[:, 0] < 0] == 0).all()
