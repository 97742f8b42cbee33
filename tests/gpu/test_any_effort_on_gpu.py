"""The fast path on a GPU against one search a voxel, on grids of every kind, wherever the pool of lists runs out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
import sdm.engine.ops
from sdm.bench.common.meshes import load_case, sphere
from sdm.kernels.dense import cost_model, query
from sdm.kernels.dense.workspace import CHUNK, NEXT_CHUNK
from tests.helpers import strategies
from tests.helpers.exactness import ROUNDING, scale_of

pytestmark = pytest.mark.gpu


def named(name: str) -> strategies.Arrays:
    case = load_case(name)
    return strategies.Arrays(case.vertices, case.faces)


def crowd(seed: int) -> strategies.Arrays:
    """A thousand small triangles, most of them about one place."""
    rng = np.random.default_rng(seed)
    at = np.concatenate([rng.uniform(-1, 1, (200, 1, 3)), 0.3 + 0.02 * rng.normal(size=(800, 1, 3))])
    corners = (at + 0.03 * rng.normal(size=(1000, 3, 3))).astype(np.float32)
    return strategies.Arrays(corners.reshape(-1, 3), np.arange(3000, dtype=np.int32).reshape(-1, 3))


meshes = st.one_of(
    st.sampled_from(["torus-20000", "torus-100000", "torus-300000", "coincident shells", "needle fan"]).map(named),
    st.sampled_from([20, 90, 250]).map(lambda rings: strategies.Arrays(*sphere(rings))),
    strategies.seeds.map(crowd),
)


@settings(max_examples=60)
@given(
    mesh=meshes,
    shape=st.tuples(*[st.integers(2, 90)] * 3),
    seed=strategies.seeds,
    turned=st.booleans(),
    # Of what is used where there is plenty, so that it may run out anywhere.
    room=st.floats(0.05, 1.1),
)
def test_against_the_search(mesh, shape, seed, turned, room):
    rng = np.random.default_rng(seed)
    used = mesh.vertices[mesh.faces].astype(np.float64)
    low, high = used.min((0, 1)), used.max((0, 1))
    size = float((high - low).max())
    spacing = size * rng.uniform(0.5, 1.2) / np.array(shape)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turned else np.eye(3)
    middle = rng.uniform(low, high) if rng.random() < 0.5 else (low + high) / 2
    grid = sdm.Grid(middle - turn @ (spacing * (np.array(shape) - 1) / 2), spacing, shape, turn)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cuda")
    entries: list[int] = []
    measure = query.measure_blocks

    def spy(*inputs: Any) -> None:
        lists = inputs[3]
        entries.append(CHUNK * (lists.given + int(lists.counts.numpy()[NEXT_CHUNK])))
        measure(*inputs)

    # A recording would keep the limits that it was made with.
    with pytest.MonkeyPatch.context() as patch, sdm.cuda_graphs.paused():
        patch.setattr(sdm.engine.ops, "DENSE_METHOD", "search")
        expected = index.signed_distance_map(grid).values
        patch.setattr(sdm.engine.ops, "DENSE_METHOD", "cells")
        patch.setattr(query, "measure_blocks", spy)
        plenty = index.signed_distance_map(grid).values
        scarce = max(CHUNK, int(room * max(entries)))
        patch.setattr(cost_model, "SMALLEST_POOL", scarce)
        patch.setattr(cost_model, "LARGEST_POOL", scarce)
        little = index.signed_distance_map(grid).values
    centres = grid.points().reshape(-1, 3).numpy()
    limit = torch.from_numpy(8 * ROUNDING * scale_of(mesh.vertices, mesh.faces, centres)).reshape(grid.shape).cuda()
    sure = expected.abs() > limit
    for values in (plenty, little):
        assert ((values.abs() - expected.abs()).abs() <= limit).all()
        assert torch.equal((values < 0)[sure], (expected < 0)[sure])
