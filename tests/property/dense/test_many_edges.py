"""Meshes with many boundary edges: blocks of voxels and groups of points share what they know of the holes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import sdm
import sdm.engine.structure.sizes
from sdm.bench.common.meshes import load_case
from sdm.kernels.winding import winding_number as kinds
from tests.helpers import strategies
from tests.helpers.exactness import assert_exact

meshes = st.one_of(strategies.soups(), strategies.slivers(), strategies.closed(), strategies.shells())
shared = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def many(monkeypatch):
    """Every open mesh counts as one with many boundary edges."""
    monkeypatch.setattr(sdm.engine.structure.sizes, "MOST_BOUNDARY_EDGES", 0)
    monkeypatch.setattr(sdm.engine.structure.sizes, "FEWEST_FACES_AN_EDGE", 0)


@settings(shared, max_examples=30)
@given(mesh=strategies.anywhere(meshes), seed=strategies.seeds)
def test_points(many, mesh, seed):
    at = strategies.points_about(mesh, seed)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    assert index._structure.kind in (kinds.CLOSED, kinds.MANY)
    assert_exact(mesh.vertices, mesh.faces, at, index.signed_distance(at))


@settings(shared, max_examples=30)
@given(mesh=meshes, shape=st.tuples(*[st.integers(1, 20)] * 3), turn=st.sampled_from([0.0, 0.3]))
def test_maps(many, mesh, shape, turn):
    spacing = [0.25, 0.125, 0.25]
    direction = [[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]]
    origin = [-0.5 * step * (count - 1) for step, count in zip(spacing, shape, strict=True)]
    grid = sdm.Grid(origin, spacing, shape, direction)
    field = sdm.signed_distance_map(sdm.TriangleMesh(*mesh), grid, device="cpu")
    assert_exact(mesh.vertices, mesh.faces, grid.points().reshape(-1, 3).numpy(), field.values)


def test_signs_are_those_of_the_tree_of_dipoles(monkeypatch):
    """A torus with a thousand small holes, which is such a mesh by itself."""
    case = load_case("torus-100000")
    keep = np.random.default_rng(1).random(len(case)) > 0.012
    mesh = sdm.TriangleMesh(case.vertices, case.faces[keep])
    grid = sdm.Grid.around(mesh, resolution=24)
    index = sdm.MeshIndex(mesh, "cpu")
    assert index._structure.kind == kinds.MANY
    values = index.signed_distance_map(grid)
    at = grid.points().reshape(-1, 3)
    monkeypatch.setattr(sdm.engine.structure.sizes, "MOST_FOR_GROUPS", 0)
    monkeypatch.setattr(sdm.engine.structure.sizes, "MOST_FOR_VOXELS", 0)
    other = sdm.MeshIndex(mesh, "cpu")
    assert other._structure.kind == kinds.SOUP
    winding = other.winding_number(at).reshape(grid.shape)
    sure = ((winding - 0.5).abs() > 1e-3) & (values.values.abs() > 1e-6)
    assert torch.equal((values.values < 0)[sure], (winding > 0.5)[sure])
    assert torch.equal((index.signed_distance(at).reshape(grid.shape) < 0)[sure], (winding > 0.5)[sure])


def test_points_about_loose_triangles_are_left_to_the_tree():
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(3 * 500, 3)).astype(np.float32)
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, np.arange(1500, dtype=np.int32).reshape(-1, 3)), "cpu")
    assert index._structure.kind == kinds.DIRTY
