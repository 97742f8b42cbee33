"""An index whose vertices moved is an index of the mesh that they make."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from tests.helpers import strategies

meshes = st.one_of(strategies.soups(), strategies.closed(), strategies.shells())
GRID = sdm.Grid([-4] * 3, [0.9] * 3, [9] * 3)


@settings(max_examples=24)
@given(meshes, strategies.seeds)
def test_updated_equals_fresh(mesh, seed):
    rng = np.random.default_rng(seed)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    moved = mesh.vertices
    for size in (1, 1e-4, 1e6):
        moved = ((mesh.vertices + 0.5 * rng.normal(size=mesh.vertices.shape)) * size).astype(np.float32)
        index.update(moved)
        fresh = sdm.MeshIndex(sdm.TriangleMesh(moved, mesh.faces), "cpu")
        points = strategies.points_about(strategies.Arrays(moved, mesh.faces), seed)
        assert torch.equal(index.signed_distance(points), fresh.signed_distance(points))
        assert torch.equal(index.winding_number(points), fresh.winding_number(points))
        assert torch.equal(index.signed_distance_map(GRID).values, fresh.signed_distance_map(GRID).values)
        assert index.closed == fresh.closed
    index.update(mesh.vertices)
    first = sdm.signed_distance_map(sdm.TriangleMesh(*mesh), GRID, device="cpu")
    assert torch.equal(index.signed_distance_map(GRID).values, first.values)


def test_moving_apart_opens_a_seam():
    """Vertices that share a place count as one; when they part, the mesh is open."""
    vertices, faces = strategies.cube()
    loose = vertices[faces].reshape(-1, 3)
    index = sdm.MeshIndex(sdm.TriangleMesh(loose, np.arange(36).reshape(-1, 3)), "cpu")
    assert index.closed
    apart = loose.copy()
    apart[:3] += 0.5
    index.update(apart)
    assert not index.closed
    index.update(loose)
    assert index.closed
    assert float(index.signed_distance([0.0, 0, 0])) == -1


def test_the_old_index_may_be_kept_by_a_graph():
    """Gradients of a query made before an update are those of the mesh as it was."""
    vertices, faces = strategies.cube()
    before = torch.tensor(vertices, requires_grad=True)
    index = sdm.MeshIndex(sdm.TriangleMesh(before, faces), "cpu")
    value = index.signed_distance(torch.tensor([[3.0, 0.25, 0.0]]))
    index.update(torch.tensor(vertices) * 2)
    value.sum().backward()
    assert before.grad is not None
    torch.testing.assert_close(before.grad.sum(0), torch.tensor([-1.0, 0, 0]))


def test_wrong_vertices_are_refused():
    vertices, faces = strategies.cube()
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu")
    with pytest.raises(sdm.MeshError, match=r"\(7, 3\).*\(8, 3\)"):
        index.update(vertices[:7])
    broken = vertices.copy()
    broken[3, 1] = np.nan
    with pytest.raises(sdm.MeshError, match="vertex 3"):
        index.update(broken)
    # Nothing has changed.
    assert float(index.signed_distance([0.0, 0, 0])) == -1
