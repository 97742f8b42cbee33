"""Voxels of coarse bricks from their cells' lists: what a search of the tree for each finds."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case
from sdm.engine.plan_override import plan_override
from sdm.kernels.dense import query

MESHES = ("torus-1000", "open hemisphere", "random soup", "zero-area faces", "coincident shells", "needle box")


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("cell", [4, 8, 16])
def test_the_same_bits(monkeypatch, name, cell):
    case = load_case(name)
    low, high = case.box
    grid = sdm.Grid(low - 0.07, [(high - low).max() / 15] * 3, (18, 17, 19))
    index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), "cpu", warn=False)
    with plan_override(method="cells", cell=cell, split_length=7, slice_factors=(1,)):
        expected = index.signed_distance_map(grid)
    with plan_override(method="cells", cell=cell, split_length=7, slice_factors=(1,), list_bricks=True):
        mended = index.signed_distance_map(grid)
        # Nothing is left for the search.
        monkeypatch.setattr(query, "mend_slab", lambda *inputs: None)
        found = index.signed_distance_map(grid)
    assert torch.equal(found.values, mended.values)
    # The list of a small cell may lack one of two needles that share the nearest edge.
    different = found.values != expected.values
    assert different.sum() <= (2 if (name, cell) == ("needle box", 4) else 0)
    torch.testing.assert_close(found.values, expected.values, rtol=1e-6, atol=0)
    assert found.ambiguous_voxels == expected.ambiguous_voxels


def test_it_is_they_that_do_it(monkeypatch):
    """Without them, and without the search, voxels of so coarse a grid have no distance."""
    case = load_case("torus-1000")
    grid = sdm.Grid([-1.1] * 3, [0.14] * 3, (17, 17, 17))
    index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), "cpu", warn=False)
    monkeypatch.setattr(query, "mend_slab", lambda *inputs: None)
    with plan_override(method="cells", cell=8, slice_factors=(1,)):
        assert np.isinf(index.signed_distance_map(grid).values.numpy()).any()
