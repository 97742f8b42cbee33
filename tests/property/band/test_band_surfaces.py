"""Surfaces of narrow bands: those of the dense map, closed for closed meshes."""

from __future__ import annotations

import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import sdm
from sdm.core.mesh import TriangleMesh
from sdm.errors import SDMError
from tests.helpers.closed_surface import assert_edges_cancel
from tests.helpers.strategies import closed

COUNTS = {"max_examples": 20}


@settings(**COUNTS)
@given(closed(), st.sampled_from([(24, 24, 24), (33, 17, 21)]), st.sampled_from([2.5, 3.0]), st.sampled_from([0, 0.4]))
def test_the_mesh_of_a_band_is_that_of_the_map(arrays, shape, half_width, share):
    """Vertices, faces and their order, though no voxel far from the surface is there."""
    mesh = TriangleMesh(*arrays)
    low, high = mesh.bounds
    assume((high - low).max() > 0)
    grid = sdm.Grid.around(mesh, shape, margin=0.3)
    level = share * min(grid.spacing)
    field = sdm.signed_distance_map(mesh, grid)
    if not bool((field.values < level).any()):
        return
    band = sdm.narrow_band(mesh, grid, half_width=half_width)
    found, whole = band.to_mesh(level), field.to_mesh(level)
    assert torch.equal(found.faces, whole.faces)
    assert torch.equal(found.vertices, whole.vertices)
    assert_edges_cancel(found.numpy()[1], len(found.vertices))


@settings(max_examples=20)
@given(closed(), st.sampled_from([(20, 20, 20), (25, 15, 18)]))
def test_dual_surfaces_with_the_mesh_s_edges_are_closed(arrays, shape):
    """Whatever points of edges are put in: each edge twice, once each way, and the band's surface is the map's."""
    mesh = TriangleMesh(*arrays)
    low, high = mesh.bounds
    assume((high - low).max() > 0)
    grid = sdm.Grid.around(mesh, shape, margin=0.3)
    field = sdm.signed_distance_map(mesh, grid)
    if not bool((field.values < 0).any()):
        return
    whole = field.to_mesh(method="dual", mesh=mesh)
    found = sdm.narrow_band(mesh, grid, half_width=3.0).to_mesh(method="dual", mesh=mesh)
    assert torch.equal(found.faces, whole.faces)
    assert torch.equal(found.vertices, whole.vertices)
    assert_edges_cancel(found.numpy()[1], len(found.vertices))


def test_a_level_beyond_the_band_is_refused():
    mesh = _ball()
    band = sdm.narrow_band(mesh, 24, half_width=2.5)
    step = band.grid.spacing[0]
    band.to_mesh(0.5 * step)
    with pytest.raises(SDMError, match="make it wider"):
        band.to_mesh(step)


def _ball() -> TriangleMesh:
    grid = sdm.Grid((-1.2,) * 3, (0.3,) * 3, (9,) * 3)
    return sdm.SDM(grid.points().norm(dim=-1) - 1, grid).to_mesh()
