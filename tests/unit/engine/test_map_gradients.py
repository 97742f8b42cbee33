"""Gradients of maps and of batches of maps in the vertices."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
import sdm.engine.gradients
from sdm.bench.common.meshes import load_case, sphere, torus

GRID = sdm.Grid([-1.1, -1.0, -0.9], [0.31, 0.43, 0.37], [7, 5, 6])


def _by_points(vertices: np.ndarray, faces: np.ndarray, weights: torch.Tensor) -> torch.Tensor:
    """The same from scattered points, whose gradients have tests of their own."""
    leaf = torch.tensor(vertices, requires_grad=True)
    values = sdm.signed_distance(sdm.TriangleMesh(leaf, faces), GRID.points(), device="cpu")
    (values * weights).sum().backward()
    assert leaf.grad is not None
    return leaf.grad


@pytest.fixture
def weights():
    return torch.randn(GRID.shape, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("chunk", [1, 70, 1 << 22])
@pytest.mark.parametrize("name", ["torus", "open hemisphere", "random soup"])
def test_map(monkeypatch, weights, name, chunk):
    """Looked up in one go, or a few layers at a time."""
    monkeypatch.setattr(sdm.engine.gradients, "BACKWARD_CHUNK", chunk)
    case = load_case(name)
    leaf = torch.tensor(case.vertices, requires_grad=True)
    field = sdm.signed_distance_map(sdm.TriangleMesh(leaf, case.faces), GRID, device="cpu")
    (field.values * weights).sum().backward()
    torch.testing.assert_close(leaf.grad, _by_points(case.vertices, case.faces, weights), atol=2e-5, rtol=1e-4)


def test_map_by_finite_differences(weights):
    vertices, faces = sphere(8)
    leaf = torch.tensor(vertices, requires_grad=True)
    field = sdm.signed_distance_map(sdm.TriangleMesh(leaf, faces), GRID, device="cpu")
    (field.values * weights).sum().backward()
    assert leaf.grad is not None
    # Growing moves every closest point outward by its own radius: smooth but for the few voxels on the medial axis.
    step = 2e-3
    larger, smaller = (
        sdm.signed_distance_map(sdm.TriangleMesh(vertices * (1 + s), faces), GRID, device="cpu").values
        for s in (step, -step)
    )
    slope = ((larger - smaller).double() * weights).sum() / (2 * step)
    assert float((leaf.grad.numpy() * vertices).sum()) == pytest.approx(float(slope), abs=0.3)


def test_batch(weights):
    vertices, faces = torus(256)
    batch = np.stack([vertices, 1.25 * vertices, vertices + np.array([0.2, 0, 0.1], np.float32)]).astype(np.float32)
    leaf = torch.tensor(batch, requires_grad=True)
    factors = torch.tensor([1.0, -2.0, 0.5])
    values = sdm.signed_distance_maps(leaf, faces, GRID, device="cpu")
    (values * weights * factors[:, None, None, None]).sum().backward()
    assert leaf.grad is not None
    for gradient, one, factor in zip(leaf.grad, batch, factors, strict=True):
        torch.testing.assert_close(gradient, factor * _by_points(one, faces, weights), atol=5e-5, rtol=1e-4)


def test_slabs_carry_gradients(weights):
    vertices, faces = torus(256)
    leaf = torch.tensor(vertices, requires_grad=True)
    index = sdm.MeshIndex(sdm.TriangleMesh(leaf, faces), "cpu")
    for begin, end, values in index.slabs(GRID, 4 * 2 * 5 * 6):
        (values * weights[begin:end]).sum().backward()
    torch.testing.assert_close(leaf.grad, _by_points(vertices, faces, weights), atol=2e-5, rtol=1e-4)


def test_without_gradients_nothing_is_kept():
    field = sdm.signed_distance_map(sdm.TriangleMesh(*torus(256)), GRID, device="cpu")
    assert not field.values.requires_grad
    leaf = torch.tensor(torus(256)[0], requires_grad=True)
    with torch.no_grad():
        assert not sdm.signed_distance_map(
            sdm.TriangleMesh(leaf, torus(256)[1]), GRID, device="cpu"
        ).values.requires_grad
