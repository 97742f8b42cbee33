"""Whatever lists are made of, by how many, in how many slices and passes, and whatever finds no room: the same map."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
import sdm.engine.ops
from sdm.bench.common.meshes import sphere
from sdm.kernels.dense import cost_model, query
from sdm.kernels.dense.workspace import CHUNK, NEXT_CHUNK
from sdm.kernels.winding import scan_convert
from tests.helpers import strategies
from tests.helpers.exactness import ROUNDING, assert_exact, scale_of
from tests.helpers.sharing import leave_levels_out, no_finer_grids, share_lists, slice_lists

# Fine ones have long lists, about their centres above all.
fine = st.integers(6, 16).map(lambda rings: strategies.Arrays(*sphere(rings)))
meshes = st.one_of(strategies.soups(60), strategies.slivers(40), strategies.closed(20), strategies.shells(8), fine)
efforts = st.fixed_dictionaries(
    {
        # Of what is used where there is plenty, so that it may run out anywhere.
        "room": st.floats(0.05, 1.1),
        "slice_length": st.sampled_from([1, 2, 7, 30, 10**6]),
        "levels": st.integers(0, 2),
        "shares": st.sampled_from([1, 2, 8]),
        "wide": st.booleans(),
        "regions": st.sampled_from([1, 3, 1 << 15]),
        "columns": st.sampled_from([1, 9, 1 << 30]),
        "finer": st.booleans(),
    }
)


@settings(max_examples=50)
@given(
    mesh=meshes,
    shape=st.tuples(*[st.integers(1, 34)] * 3),
    seed=strategies.seeds,
    turned=st.booleans(),
    shared=efforts,
)
def test_against_the_brute_force(mesh, shape, seed, turned, shared):
    rng = np.random.default_rng(seed)
    used = mesh.vertices[mesh.faces].astype(np.float64)
    low, high = used.min((0, 1)), used.max((0, 1))
    size = float((high - low).max()) or 1.0
    spacing = size * 10.0 ** rng.uniform(-2.5, 0, 3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turned else np.eye(3)
    turn[:, 2] *= np.linalg.det(turn)
    middle = rng.uniform(low, high + 1e-3 * size)
    grid = sdm.Grid(middle - turn @ (spacing * (np.array(shape) - 1) / 2), spacing, shape, turn)
    used_by_pass: list[int] = []
    measure = query.measure_blocks

    def spy(*inputs: Any) -> None:
        lists = inputs[3]
        used_by_pass.append(CHUNK * (lists.given + int(lists.counts.numpy()[NEXT_CHUNK])))
        measure(*inputs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sdm.engine.ops, "DENSE_METHOD", "cells")
        patch.setattr(query, "measure_blocks", spy)
        patch.setattr(cost_model, "MOST_REGIONS", shared["regions"])
        patch.setitem(cost_model.SHORT_FOR_WIDE, "cpu", 1e9 if shared["wide"] else 0)
        patch.setitem(scan_convert.MOST_COLUMNS, "cpu", shared["columns"])
        if not shared["finer"]:
            no_finer_grids(patch)
        slice_lists(patch, shared["slice_length"])
        leave_levels_out(patch, shared["levels"])
        share_lists(patch, shared["shares"])
        index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
        plenty = index.signed_distance_map(grid).values
        patch.setattr(cost_model, "CPU_POOL", max(CHUNK, int(shared["room"] * max(used_by_pass))))
        scarce = index.signed_distance_map(grid).values
    centres = grid.points().reshape(-1, 3).numpy()
    limit = torch.from_numpy(8 * ROUNDING * scale_of(mesh.vertices, mesh.faces, centres)).reshape(grid.shape)
    assert ((plenty.abs() - scarce.abs()).abs() <= limit).all()
    some = rng.permutation(len(centres))[:400]
    assert_exact(mesh.vertices, mesh.faces, centres[some], scarce.reshape(-1)[torch.from_numpy(some)])
