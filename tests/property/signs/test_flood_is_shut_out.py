"""Nothing inside a closed surface is ever called outside: at any resolution, for any size of holes, at any angle."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm


def tetrahedra(seed: int, count: int, flat: float) -> tuple[np.ndarray, np.ndarray]:
    """Tetrahedra that face outward, overlap, and may be thinner than a voxel."""
    random = np.random.default_rng(seed)
    corners = random.random((count, 1, 3)) + random.normal(size=(count, 4, 3)) * [0.4, 0.4, 0.4 * flat]
    corners = corners.astype(np.float32)
    a, b, c, d = corners.astype(np.float64).transpose(1, 0, 2)
    turned = ((b - a) * np.cross(c - a, d - a)).sum(1) < 0
    corners[turned] = corners[turned][:, [1, 0, 2, 3]]
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return corners.reshape(-1, 3), (faces + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)


@settings(max_examples=24)
@given(
    st.integers(0, 10**6),
    st.integers(1, 6),
    st.sampled_from([1.0, 0.1, 0.01]),
    st.integers(6, 16),
    st.floats(0.0, 3.0),
    st.tuples(*[st.sampled_from([1.0, 1.3, 2.0])] * 3),
)
def test_what_winding_numbers_enclose_is_inside(seed, count, flat, resolution, voxels, stretch):
    mesh = sdm.TriangleMesh(*tetrahedra(seed, count, flat))
    plain = sdm.Grid.around(mesh, resolution)
    spacing = np.multiply(plain.spacing, stretch)
    shape = np.ceil(np.array(plain.shape) / stretch).astype(int) + 1
    grid = sdm.Grid(plain.origin, spacing, shape)
    index = sdm.MeshIndex(mesh, "cpu", warn=False)
    by_winding = index.signed_distance_map(grid).values
    found = index.signed_distance_map(grid, sign="flood", hole_size=voxels * float(spacing.max())).values
    assert torch.equal(found.abs(), by_winding.abs())
    off = by_winding.abs() > 1e-6
    assert not bool(((by_winding < 0) & ~(found < 0) & off).any())
    # A larger grid around it says the same of these voxels.
    wide = sdm.Grid(np.subtract(grid.origin, 2 * spacing), spacing, shape + 4)
    same = index.signed_distance_map(wide, sign="flood", hole_size=voxels * float(spacing.max())).values
    assert torch.equal((same < 0)[2:-2, 2:-2, 2:-2][off], (found < 0)[off])
