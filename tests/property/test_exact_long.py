"""The same properties on thousands of meshes more."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import sdm
import sdm.engine.structure.sizes
from tests.helpers import strategies
from tests.helpers.exactness import assert_exact, assert_winding

pytestmark = pytest.mark.slow
meshes = st.one_of(strategies.soups(), strategies.slivers(), strategies.closed(), strategies.shells())


@pytest.mark.parametrize("edges", [0, 1024], ids=["dipoles", "boundary"])
@settings(max_examples=3000, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mesh=strategies.anywhere(meshes), seed=strategies.seeds)
def test_points(monkeypatch, edges, mesh, seed):
    monkeypatch.setattr(sdm.engine.structure.sizes, "MOST_BOUNDARY_EDGES", edges)
    points = strategies.points_about(mesh, seed)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    assert_exact(mesh.vertices, mesh.faces, points, index.signed_distance(points))
    if edges:
        assert_winding(mesh.vertices, mesh.faces, points, index.winding_number(points))


@settings(max_examples=1500)
@given(strategies.anywhere(meshes), strategies.seeds, st.integers(2, 9), st.sampled_from([0.0, 0.1234]))
def test_maps(mesh, seed, count, off):
    used = mesh.vertices[mesh.faces].astype(float)
    low, high = used.min((0, 1)), used.max((0, 1))
    size = max(float((high - low).max()), 1e-3 * float(abs(used).max())) or 1.0
    grid = sdm.Grid(low - size * (0.5 + off), [2 * size / count] * 3, [count] * 3)
    field = sdm.signed_distance_map(sdm.TriangleMesh(*mesh), grid, device="cpu")
    assert_exact(mesh.vertices, mesh.faces, grid.points().reshape(-1, 3).numpy(), field.values)
