"""Gradients of scattered distances against finite differences, in points and in vertices."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube, sphere, torus
from tests.helpers import oracle

MESHES = {"cube": cube(), "sphere": sphere(6), "torus": torus(144)}


def _signed(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    distance, _, _ = oracle.distance(vertices, faces, points)
    return np.where(oracle.winding_number(vertices, faces, points) > 0.5, -distance, distance)


def _smooth(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, step: float) -> np.ndarray:
    """Points off the surface around which the field has one derivative: it looks the same at two step widths."""
    slopes = [_slopes(vertices, faces, points, s) for s in (step, step / 4)]
    calm = np.abs(slopes[0] - slopes[1]).max(1) < 1e-3
    return calm & (np.abs(_signed(vertices, faces, points)) > 10 * step)


def _slopes(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, step: float) -> np.ndarray:
    sides = [
        (_signed(vertices, faces, points + step * axis) - _signed(vertices, faces, points - step * axis)) / (2 * step)
        for axis in np.eye(3)
    ]
    return np.stack(sides, 1)


@pytest.mark.parametrize("name", MESHES)
def test_in_points(name):
    vertices, faces = MESHES[name]
    points = np.random.default_rng(1).uniform(-1.4, 1.4, (300, 3)).astype(np.float32)
    calm = _smooth(vertices, faces, points, 1e-3)
    assert calm.mean() > 0.7
    points = points[calm]
    at = torch.tensor(points, requires_grad=True)
    sdm.signed_distance(sdm.TriangleMesh(vertices, faces), at, device="cpu").sum().backward()
    assert at.grad is not None
    np.testing.assert_allclose(at.grad, _slopes(vertices, faces, points, 1e-3), atol=2e-3)
    np.testing.assert_allclose(at.grad.norm(dim=1), 1, atol=1e-5)


@pytest.mark.parametrize("name", MESHES)
def test_in_vertices(name):
    """Move every vertex a little: the change of a weighted sum of distances is what the gradient says."""
    vertices, faces = MESHES[name]
    rng = np.random.default_rng(2)
    points = rng.uniform(-1.4, 1.4, (200, 3)).astype(np.float32)
    points = points[_smooth(vertices, faces, points, 1e-2)]
    weights = rng.normal(size=len(points))
    leaf = torch.tensor(vertices, requires_grad=True)
    values = sdm.signed_distance(sdm.TriangleMesh(leaf, faces), points, device="cpu")
    (values * torch.from_numpy(weights)).sum().backward()
    assert leaf.grad is not None
    for _ in range(4):
        way = rng.normal(size=vertices.shape)
        step = 1e-4
        change = _signed(vertices + step * way, faces, points) - _signed(vertices - step * way, faces, points)
        assert float((leaf.grad.numpy() * way).sum()) == pytest.approx((weights @ change) / (2 * step), abs=0.02)


def test_at_a_vertex_it_is_the_weight_times_the_direction():
    leaf = torch.tensor([[0.0, 0, 0], [4, 0, 0], [0, 3, 0]], requires_grad=True)
    point = torch.tensor([[1.0, 1, 2]], requires_grad=True)
    sdm.signed_distance(sdm.TriangleMesh(leaf, [[0, 1, 2]]), point, device="cpu").sum().backward()
    assert point.grad is not None
    assert leaf.grad is not None
    torch.testing.assert_close(point.grad, torch.tensor([[0.0, 0, 1]]))
    torch.testing.assert_close(leaf.grad, torch.tensor([[0, 0, -5 / 12], [0, 0, -3 / 12], [0, 0, -4 / 12]]))


def test_inside_it_points_outward_too():
    point = torch.tensor([[0.75, 0.1, 0.2], [1.5, 0.1, 0.2], [-0.75, 0.1, 0.2]], requires_grad=True)
    sdm.signed_distance(sdm.TriangleMesh(*cube()), point, device="cpu").sum().backward()
    torch.testing.assert_close(point.grad, torch.tensor([[1.0, 0, 0], [1, 0, 0], [-1, 0, 0]]))


def test_moving_all_together_changes_nothing():
    """Whatever the points, the gradients of vertices and points add up to nothing."""
    vertices, faces = torus(256)
    leaf = torch.tensor(vertices, requires_grad=True)
    points = torch.randn(500, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    sdm.signed_distance(sdm.TriangleMesh(leaf, faces), points, device="cpu").sum().backward()
    assert points.grad is not None
    assert leaf.grad is not None
    torch.testing.assert_close(leaf.grad.sum(0), -points.grad.sum(0), atol=1e-3, rtol=0)


@pytest.mark.parametrize("prebuilt", [False, True])
def test_through_an_index_and_without(prebuilt):
    vertices, faces = sphere(6)
    leaf = torch.tensor(vertices, requires_grad=True)
    points = torch.tensor([[2.0, 0.3, 0.1], [0.2, 0.1, 0.6]], requires_grad=True)
    mesh = sdm.TriangleMesh(leaf, faces)
    if prebuilt:
        values, hit = sdm.MeshIndex(mesh, "cpu").signed_distance(points, return_closest=True)
        assert not hit.points.requires_grad
    else:
        values = sdm.signed_distance(mesh, points, device="cpu")
    values.pow(2).sum().backward()
    assert points.grad is not None
    torch.testing.assert_close(points.grad.norm(dim=1), 2 * values.detach().abs())
    assert leaf.grad is not None
    torch.testing.assert_close(leaf.grad.sum(0), -points.grad.sum(0))


def test_float64_points_get_float64_gradients():
    points = torch.tensor([[2.0, 0.3, 0.1]], dtype=torch.float64, requires_grad=True)
    sdm.signed_distance(sdm.TriangleMesh(*cube()), points, device="cpu").sum().backward()
    assert points.grad is not None
    assert points.grad.dtype == torch.float64
    torch.testing.assert_close(points.grad, torch.tensor([[1.0, 0, 0]], dtype=torch.float64))


def test_a_point_that_is_not_finite_spoils_no_other():
    leaf = torch.tensor(cube()[0], requires_grad=True)
    points = torch.tensor([[2.0, 0.3, 0.1], [float("nan"), 0, 0], [0, float("inf"), 0]], requires_grad=True)
    values = sdm.signed_distance(sdm.TriangleMesh(leaf, cube()[1]), points, device="cpu")
    assert values.isnan().tolist() == [False, True, True]
    torch.where(values.isnan(), 0, values).sum().backward()
    assert points.grad is not None
    assert points.grad.tolist() == [[1, 0, 0], [0, 0, 0], [0, 0, 0]]
    assert leaf.grad is not None
    torch.testing.assert_close(leaf.grad.sum(0), torch.tensor([-1.0, 0, 0]))


def test_no_points_no_gradient():
    points = torch.zeros(0, 3, requires_grad=True)
    leaf = torch.tensor(cube()[0], requires_grad=True)
    sdm.signed_distance(sdm.TriangleMesh(leaf, cube()[1]), points, device="cpu").sum().backward()
    assert points.grad is not None
    assert points.grad.shape == (0, 3)
    assert leaf.grad is not None
    assert (leaf.grad == 0).all()
