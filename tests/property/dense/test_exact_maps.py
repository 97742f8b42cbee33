"""Maps: exact distances and right signs at every voxel, on grids that share planes, edges and corners with the mesh."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from tests.helpers import strategies
from tests.helpers.exactness import assert_exact

meshes = st.one_of(strategies.soups(), strategies.slivers(), strategies.closed(), strategies.shells())


@st.composite
def grids(draw: st.DrawFn, mesh: strategies.Arrays) -> sdm.Grid:
    """Aligned with the mesh's own numbers, or anywhere about it."""
    used = mesh.vertices[mesh.faces].astype(np.float64)
    low, high = used.min((0, 1)), used.max((0, 1))
    size = max(float((high - low).max()), 1e-3 * float(np.abs(used).max())) or 1.0
    shape = draw(st.tuples(*[st.integers(1, 11)] * 3))
    spacing = size * np.array(draw(st.tuples(*[st.sampled_from([0.0625, 0.25, 0.5, 1 / 3, 4.0])] * 3)))
    before = np.array(draw(st.tuples(*[st.integers(-1, 4)] * 3)))
    off = draw(st.sampled_from([0.0, 0.0, 0.1234]))
    return sdm.Grid(low - spacing * (before + off), spacing, shape)


@settings(max_examples=60)
@given(strategies.anywhere(meshes), st.data())
def test_maps_equal_the_brute_force(mesh, data):
    grid = data.draw(grids(mesh))
    field = sdm.signed_distance_map(sdm.TriangleMesh(*mesh), grid, device="cpu")
    assert tuple(field.values.shape) == grid.shape
    assert_exact(mesh.vertices, mesh.faces, grid.points().reshape(-1, 3).numpy(), field.values)


@settings(max_examples=24)
@given(strategies.shells(), st.integers(1, 4), st.sampled_from([0.5, 1.0, 0.25]))
def test_grids_on_the_lattice_of_the_cubes(mesh, per_unit, off):
    """Every ray along a row of voxels runs through corners, edges and faces' planes."""
    grid = sdm.Grid([-5.0 + off] * 3, [1.0 / per_unit] * 3, [10 * per_unit] * 3)
    grid = sdm.Grid(grid.origin, grid.spacing, [min(n, 16) for n in grid.shape])
    field = sdm.signed_distance_map(sdm.TriangleMesh(*mesh), grid, device="cpu")
    assert_exact(mesh.vertices, mesh.faces, grid.points().reshape(-1, 3).numpy(), field.values)
