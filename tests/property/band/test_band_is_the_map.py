"""A narrow band's blocks and values are those of the dense map, bit for bit, on any mesh and grid."""

from __future__ import annotations

from unittest import mock

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import sphere
from sdm.engine.band import band_slabs, block_distances, listed_blocks, near_blocks
from sdm.engine.plan_override import plan_override
from tests.helpers import strategies


def holed(rings: int, share: float) -> strategies.Arrays:
    vertices, faces = sphere(rings)
    return strategies.Arrays(vertices, faces[: max(1, int(share * len(faces)))])


open_spheres = st.builds(holed, st.integers(4, 9), st.floats(0.3, 0.99))
fine = st.integers(6, 14).map(lambda rings: strategies.Arrays(*sphere(rings)))
meshes = st.one_of(
    strategies.soups(60), strategies.slivers(40), strategies.closed(20), strategies.shells(6), open_spheres, fine
)
efforts = st.fixed_dictionaries(
    {
        "method": st.sampled_from(["auto", "cells", "search"]),
        "cell": st.sampled_from([None, 8, 16]),
        "levels_left_out": st.sampled_from([None, 1]),
        "slice_factors": st.sampled_from([(1,), (1, 2, 4, 8, 16)]),
    }
)


@settings(max_examples=24)
@given(
    mesh=meshes,
    shape=st.tuples(*[st.integers(1, 40)] * 3),
    half_width=st.floats(1.5, 9),
    sign=st.sampled_from(["winding", "winding", "none"]),
    seed=strategies.seeds,
    turned=st.booleans(),
    even=st.booleans(),
    effort=efforts,
    by_bits=st.booleans(),
    by_triangles=st.booleans(),
    early=st.booleans(),
)
def test_any_mesh_and_grid(mesh, shape, half_width, sign, seed, turned, even, effort, by_bits, by_triangles, early):
    rng = np.random.default_rng(seed)
    used = mesh.vertices[mesh.faces].astype(np.float64)
    low, high = used.min((0, 1)), used.max((0, 1))
    size = float((high - low).max()) or 1.0
    spacing = size * 10.0 ** rng.uniform(-2, -0.5, 3)
    spacing = np.full(3, spacing[0]) if even else spacing
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turned else np.eye(3)
    turn[:, 2] *= np.linalg.det(turn)
    middle = rng.uniform(low, high + 1e-3 * size)
    grid = sdm.Grid(middle - turn @ (spacing * (np.array(shape) - 1) / 2), spacing, shape, turn)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu", warn=False)
    # As of grids with very many blocks; as a GPU marks blocks; and as bands are copied that have many.
    with (
        plan_override(**effort),
        mock.patch.object(listed_blocks, "MOST_BITS", band_slabs.MOST_BLOCKS if by_bits else 0),
        mock.patch.object(near_blocks, "BY_TRIANGLES", ("cpu",) if by_triangles else ()),
        mock.patch.object(block_distances, "MOST_EARLY", block_distances.MOST_EARLY if early else 0),
    ):
        band = index.narrow_band(grid, half_width=half_width, sign=sign)
        dense = index.signed_distance_map(grid, sign=sign)
    clamped = dense.values.clamp(-band.width, band.width)
    near = clamped.abs() < band.width
    assert torch.equal(band.blocks.long(), torch.unique(near.nonzero() // 8, dim=0))
    found = band.to_dense().values
    if index.closed:
        assert torch.equal(found, clamped)
    # Of other meshes the sign of a block that is not stored is that of its middle.
    stored = torch.zeros_like(near)
    for x, y, z in (8 * band.blocks).tolist():
        stored[x : x + 8, y : y + 8, z : z + 8] = True
    assert torch.equal(found[stored], clamped[stored])
    assert torch.equal(found.abs(), clamped.abs())
