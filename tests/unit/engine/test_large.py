"""Sizes beyond 32-bit indices are split into several launches, or refused: with limits lowered for the test."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.core.demo_mesh import demo_mesh
from sdm.engine import maps, ops
from sdm.errors import GridError

MESH = demo_mesh(rings=21, segments=12)
GRID = sdm.Grid.around(MESH, resolution=40)


def test_a_map_of_several_slabs_is_the_map(monkeypatch):
    whole = sdm.signed_distance_map(MESH, GRID, device="cpu").values
    batch = torch.stack([MESH.vertices, 0.9 * MESH.vertices, 1.1 * MESH.vertices])
    several = sdm.signed_distance_maps(batch, MESH.faces, GRID, device="cpu")
    for most in (32 * 40 * 40, 2 * 32 * 40 * 40):
        monkeypatch.setattr(maps, "LARGEST_SLAB", most)
        monkeypatch.setattr("sdm.engine.mesh_index.LARGEST_SLAB", most)
        assert torch.equal(sdm.signed_distance_map(MESH, GRID, device="cpu").values, whole)
        assert torch.equal(sdm.signed_distance_maps(batch, MESH.faces, GRID, device="cpu"), several)


def test_gradients_go_through_slabs(monkeypatch):
    def gradient() -> torch.Tensor:
        vertices = MESH.vertices.clone().requires_grad_()
        sdm.signed_distance_maps(vertices[None], MESH.faces, GRID, device="cpu").square().sum().backward()
        assert vertices.grad is not None
        return vertices.grad

    whole = gradient()
    monkeypatch.setattr(maps, "LARGEST_SLAB", 32 * 40 * 40)
    torch.testing.assert_close(gradient(), whole, rtol=1e-4, atol=1e-3)


def test_a_slab_that_cannot_be_counted_is_refused(monkeypatch):
    monkeypatch.setattr(maps, "LARGEST_SLAB", 32 * 40 * 40 - 1)
    with pytest.raises(GridError, match="split it along y or z"):
        sdm.signed_distance_map(MESH, GRID, device="cpu")
    with pytest.raises(GridError, match=r"32 layers of a grid of shape \(40, 40, 40\)"):
        sdm.signed_distance_maps(MESH.vertices[None], MESH.faces, GRID, device="cpu")
    # A grid of few layers has no more than those.
    thin = sdm.Grid(GRID.origin, GRID.spacing, (20, 40, 40))
    assert sdm.signed_distance_map(MESH, thin, device="cpu").values.shape == thin.shape


def test_points_in_several_launches(monkeypatch):
    points = 5 * torch.randn(1000, 3, generator=torch.Generator().manual_seed(0))
    index = sdm.MeshIndex(MESH, "cpu")
    distance, hit = index.signed_distance(points, return_closest=True)
    winding = index.winding_number(points)
    monkeypatch.setattr(ops, "MOST_POINTS", 301)
    again, other = index.signed_distance(points, return_closest=True)
    assert torch.equal(again, distance)
    assert torch.equal(other.points, hit.points)
    # On an edge either face is the nearest.
    assert (other.faces == hit.faces).float().mean() > 0.8
    assert torch.equal(index.winding_number(points), winding)
    assert torch.equal(sdm.signed_distance(MESH, points, device="cpu"), distance)
