"""A narrow band with the sign of a flood has the bits of the dense map's, which floods the whole grid."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import sphere
from tests.helpers import strategies


def holed(rings: int, share: float) -> strategies.Arrays:
    vertices, faces = sphere(rings)
    return strategies.Arrays(vertices, faces[: max(1, int(share * len(faces)))])


def pierced(rings: int, hole: int) -> strategies.Arrays:
    """A sphere without some triangles here and there, whose holes get caps."""
    vertices, faces = sphere(rings)
    return strategies.Arrays(vertices, np.delete(faces, np.arange(len(faces) // hole) * hole, 0))


def assert_is_the_map(index: sdm.MeshIndex, grid: sdm.Grid, half_width: float, hole: float | None) -> torch.Tensor:
    band = index.narrow_band(grid, half_width=half_width, sign="flood", hole_size=hole)
    dense = index.signed_distance_map(grid, sign="flood", hole_size=hole)
    assert (band.sign, band.hole_size) == ("flood", dense.hole_size)
    clamped = dense.values.clamp(-band.width, band.width)
    near = clamped.abs() < band.width
    assert torch.equal(band.blocks.long(), torch.unique(near.nonzero() // 8, dim=0))
    found = band.to_dense().values
    corners = torch.zeros([-(-n // 8) for n in grid.shape], dtype=torch.bool, device=near.device)
    corners[tuple(band.blocks.long().T)] = True
    x, y, z = (torch.arange(n, device=near.device) // 8 for n in grid.shape)
    stored = corners[x[:, None, None], y[:, None], z]
    assert torch.equal(found[stored].view(torch.int32), clamped[stored].view(torch.int32))
    # Of a block that is not stored a voxel near its middle says the side.
    differ = (found != clamped)[~stored]
    assert torch.equal(found.abs(), clamped.abs())
    return differ


meshes = st.one_of(
    strategies.soups(40),
    strategies.slivers(30),
    strategies.closed(20),
    strategies.shells(6),
    st.builds(holed, st.integers(4, 9), st.floats(0.3, 0.99)),
    st.builds(pierced, st.integers(5, 12), st.integers(5, 40)),
)


@settings(max_examples=16)
@given(
    mesh=meshes,
    shape=st.tuples(*[st.integers(8, 60)] * 3),
    half_width=st.floats(1.5, 9),
    hole=st.one_of(st.none(), st.floats(0, 5)),
    seed=strategies.seeds,
    turned=st.booleans(),
    even=st.booleans(),
    aside=st.sampled_from([0.0, 0.0, 0.4]),
)
def test_any_mesh_and_grid(mesh, shape, half_width, hole, seed, turned, even, aside):
    rng = np.random.default_rng(seed)
    used = mesh.vertices[mesh.faces].astype(np.float64)
    low, high = used.min((0, 1)), used.max((0, 1))
    size = float((high - low).max()) or 1.0
    # Mostly around all of the mesh.
    spacing = size * 1.2 / np.array(shape) * (1 if aside == 0 else 0.7)
    spacing = np.full(3, spacing.max()) if even else spacing
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turned else np.eye(3)
    turn[:, 2] *= np.linalg.det(turn)
    middle = (low + high) / 2 + aside * size * rng.uniform(-1, 1, 3)
    grid = sdm.Grid(middle - turn @ (spacing * (np.array(shape) - 1) / 2), spacing, shape, turn)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu", warn=False)
    assert_is_the_map(index, grid, half_width, None if hole is None else hole * float(spacing.max()))


@pytest.mark.parametrize("hole", [None, 0.0, 0.5])
def test_where_gaps_are_not_stored(hole, device):
    """Inside and outside are far from the surface, and there are holes that are closed and one that is not."""
    for arrays in (sphere(12), pierced(12, 37), holed(12, 0.8)):
        index = sdm.MeshIndex(sdm.TriangleMesh(*arrays), device, warn=False)
        differ = assert_is_the_map(index, sdm.Grid.around(index.mesh, 72, margin=0.3), 3.0, hole)
        assert not differ.any()


@pytest.mark.parametrize(("hole", "filled"), [(1.95, False), (2.05, True)])
def test_a_ball_that_just_passes(hole, filled, device):
    """Half a sphere of radius 1: the ball is 40 voxels wide, and so far from the surface all has to be known."""
    vertices, faces = sphere(16)
    half = sdm.TriangleMesh(vertices, faces[(vertices[faces][:, :, 2] < 0.01).all(1)])
    index = sdm.MeshIndex(half, device, warn=False)
    grid = sdm.Grid((-1.4,) * 3, (0.05,) * 3, (57,) * 3)
    # The plane of the opening goes through blocks, of which each has one side.
    assert assert_is_the_map(index, grid, 1.5, hole).float().mean() < (0.03 if filled else 1e-9)
    band = index.narrow_band(grid, half_width=1.5, sign="flood", hole_size=hole)
    assert (band.inside_voxels > 10000) == filled


def test_a_grid_in_the_mesh(device):
    index = sdm.MeshIndex(sdm.TriangleMesh(*sphere(12)), device)
    grid = sdm.Grid((-0.5, -0.4, 0.3), (0.03,) * 3, (30, 40, 33))
    assert not assert_is_the_map(index, grid, 3.0, None).any()
