"""Winding numbers of closed meshes, of meshes with a boundary and of soups, each by its own kernels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import sdm
import sdm.engine.structure.sizes
from tests.helpers import oracle, strategies
from tests.helpers.exactness import ROUNDING, assert_exact, assert_winding, scale_of

meshes = st.one_of(strategies.soups(), strategies.slivers(), strategies.closed(), strategies.shells())
per_function = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@settings(max_examples=80)
@given(strategies.anywhere(meshes), strategies.seeds)
def test_closed_and_open(mesh, seed):
    points = strategies.points_about(mesh, seed)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    winding = index.winding_number(points)
    assert_winding(mesh.vertices, mesh.faces, points, winding)
    if index.closed:
        assert (winding == winding.round()).all()


@settings(per_function, max_examples=50)
@given(mesh=strategies.anywhere(st.one_of(strategies.soups(40), strategies.slivers(40))), seed=strategies.seeds)
def test_soup(monkeypatch: pytest.MonkeyPatch, mesh, seed):
    """The tree of dipoles: within 4e-4 near 0.25, 0.5 and 0.75, elsewhere on the right side of them."""
    monkeypatch.setattr(sdm.engine.structure.sizes, "MOST_BOUNDARY_EDGES", 0)
    points = strategies.points_about(mesh, seed)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    found = index.winding_number(points).double().numpy()
    far, _, _ = oracle.distance(mesh.vertices, mesh.faces, points)
    off = far > 4 * ROUNDING * scale_of(mesh.vertices, mesh.faces, points)
    found, expected = found[off], oracle.winding_number(mesh.vertices, mesh.faces, points)[off]
    for threshold in (0.25, 0.5, 0.75):
        clear = np.abs(expected - threshold) > 5e-4
        assert ((found > threshold) == (expected > threshold))[clear].all()
        assert (np.abs(found - expected)[~clear] < 5e-4).all()
    assert_exact(mesh.vertices, mesh.faces, points, index.signed_distance(points))


def test_soup_of_many_triangles():
    """More boundary edges than the other way takes, without any help."""
    from sdm.bench.common.meshes import load_case

    case = load_case("random soup")
    rng = np.random.default_rng(2)
    points = rng.uniform(-1.5, 1.5, (1500, 3)).astype(np.float32)
    index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), "cpu")
    assert len(case) * 3 > sdm.engine.structure.sizes.MOST_BOUNDARY_EDGES
    found = index.winding_number(points).double().numpy()
    expected = oracle.winding_number(case.vertices, case.faces, points)
    for threshold in (0.25, 0.5, 0.75):
        clear = np.abs(expected - threshold) > 5e-4
        assert ((found > threshold) == (expected > threshold))[clear].all()
    assert_exact(case.vertices, case.faces, points, index.signed_distance(points))
