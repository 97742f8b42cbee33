"""Far from the origin only what float32 itself rounds away is lost."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from tests.helpers import oracle, strategies
from tests.helpers.exactness import ROUNDING, assert_exact, scale_of

closed = st.one_of(strategies.closed(), strategies.shells())
meshes = st.one_of(strategies.soups(), closed)


@settings(max_examples=30)
@given(meshes, strategies.seeds, st.sampled_from([1.0, 1e2, 1e4]), st.integers(0, 7))
def test_ten_thousand_boxes_away(mesh, seed, boxes, corner):
    points = strategies.points_about(mesh, seed)
    size = float(np.ptp(mesh.vertices[mesh.faces], (0, 1)).max())
    shift = boxes * size * np.array([1 if corner & bit else -1 for bit in (1, 2, 4)])
    moved = strategies.Arrays((mesh.vertices + shift).astype(np.float32), mesh.faces)
    there = (points + shift).astype(np.float32)
    here = sdm.signed_distance(sdm.TriangleMesh(*mesh), points, device="cpu").double().numpy()
    far = sdm.signed_distance(sdm.TriangleMesh(*moved), there, device="cpu")
    assert_exact(moved.vertices, moved.faces, there, far)
    # Mesh and point each move by half a float32 step along each axis, and the distance rounds as anywhere.
    limit = (4 + 2 * 3**0.5) * ROUNDING * scale_of(moved.vertices, moved.faces, there)
    assert (np.abs(np.abs(here) - far.abs().double().numpy()) <= limit).all()


@settings(max_examples=24)
@given(closed, st.sampled_from([2.0**10, 2.0**14]))
def test_a_move_that_rounds_nothing_changes_no_sign(mesh, shift):
    """On a lattice of 1/16 everything is exact, so the map must be the same one."""
    mesh = strategies.Arrays(np.round(mesh.vertices * 16) / np.float32(16), mesh.faces)
    grid = sdm.Grid([-4] * 3, [0.6875] * 3, [12] * 3)
    there = sdm.Grid([-4 + shift, -4 - shift, -4], grid.spacing, grid.shape)
    plain = sdm.signed_distance_map(sdm.TriangleMesh(*mesh), grid, device="cpu").values
    moved = mesh.vertices + np.array([shift, -shift, 0], np.float32)
    values = sdm.signed_distance_map(sdm.TriangleMesh(moved, mesh.faces), there, device="cpu").values
    far, _, _ = oracle.distance(mesh.vertices, mesh.faces, grid.points().reshape(-1, 3).numpy())
    off = torch.from_numpy(far.reshape(grid.shape) > 4 * ROUNDING * shift)
    assert torch.equal((plain < 0)[off], (values < 0)[off])
    assert (plain.abs() - values.abs()).abs().max() <= 8 * ROUNDING * shift
