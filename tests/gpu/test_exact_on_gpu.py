"""The hypothesis meshes once more, on a GPU: points, maps and winding numbers against the brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import sdm
import sdm.engine.structure.sizes
from sdm.bench.common.meshes import cube, sphere
from tests.helpers import strategies
from tests.helpers.exactness import assert_exact, assert_winding

pytestmark = pytest.mark.gpu
meshes = st.one_of(strategies.soups(), strategies.slivers(), strategies.closed(), strategies.shells())


@settings(max_examples=150)
@given(strategies.anywhere(meshes), strategies.seeds)
def test_points(mesh, seed):
    points = strategies.points_about(mesh, seed)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cuda")
    assert_exact(mesh.vertices, mesh.faces, points, index.signed_distance(points))
    assert_winding(mesh.vertices, mesh.faces, points, index.winding_number(points))


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mesh=strategies.anywhere(strategies.soups(40)), seed=strategies.seeds)
def test_soups(monkeypatch, mesh, seed):
    monkeypatch.setattr(sdm.engine.structure.sizes, "MOST_BOUNDARY_EDGES", 0)
    points = strategies.points_about(mesh, seed)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cuda")
    assert_exact(mesh.vertices, mesh.faces, points, index.signed_distance(points))


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mesh=strategies.anywhere(meshes), seed=strategies.seeds, shape=st.tuples(*[st.integers(1, 20)] * 3))
def test_many_boundary_edges(monkeypatch, mesh, seed, shape):
    monkeypatch.setattr(sdm.engine.structure.sizes, "MOST_BOUNDARY_EDGES", 0)
    monkeypatch.setattr(sdm.engine.structure.sizes, "FEWEST_FACES_AN_EDGE", 0)
    points = strategies.points_about(mesh, seed)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cuda")
    assert_exact(mesh.vertices, mesh.faces, points, index.signed_distance(points))
    grid = sdm.Grid([-0.125 * (n - 1) for n in shape], [0.25] * 3, shape)
    centres = grid.points().reshape(-1, 3).numpy()
    assert_exact(mesh.vertices, mesh.faces, centres, index.signed_distance_map(grid).values)


@settings(max_examples=100)
@given(meshes, st.tuples(*[st.integers(1, 20)] * 3), st.sampled_from([0.25, 0.4, 0.5]))
def test_maps(mesh, shape, spacing):
    grid = sdm.Grid([-0.5 * spacing * (n - 1) for n in shape], [spacing, 0.5 * spacing, spacing], shape)
    field = sdm.signed_distance_map(sdm.TriangleMesh(*mesh), grid, device="cuda")
    assert_exact(mesh.vertices, mesh.faces, grid.points().reshape(-1, 3).numpy(), field.values)


@pytest.mark.parametrize("reach", [0.0, 1e-6, 1e3])
def test_near_ties(reach):
    vertices, faces = sphere(32)
    points = (reach * np.random.default_rng(0).normal(size=(300, 3))).astype(np.float32)
    assert_exact(vertices, faces, points, sdm.signed_distance(sdm.TriangleMesh(vertices, faces), points, device="cuda"))


@pytest.mark.parametrize("missing", [0, 1, 2, 3])
def test_rays_through_corners(missing):
    vertices, faces = cube()
    faces = faces[missing:]
    points = np.stack(np.meshgrid(*[np.linspace(-2, 2, 17)] * 3, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    points = np.concatenate([points, points + np.array([0, 1e-9, -1e-12], np.float32)])
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cuda")
    assert_exact(vertices, faces, points, index.signed_distance(points))
    assert_winding(vertices, faces, points, index.winding_number(points))
