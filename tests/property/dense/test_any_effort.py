"""Whatever lists are made of, by how many, in how many splits and passes, and whatever finds no room: the same map."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import sphere
from sdm.engine.plan_override import plan_override
from sdm.kernels.dense.chunk_pool import CHUNK
from tests.helpers import strategies
from tests.helpers.exactness import ROUNDING, assert_exact, scale_of
from tests.helpers.watch_measuring import entries_used, watching

# Fine ones have long lists, about their centres above all.
fine = st.integers(6, 16).map(lambda rings: strategies.Arrays(*sphere(rings)))
meshes = st.one_of(strategies.soups(60), strategies.slivers(40), strategies.closed(20), strategies.shells(8), fine)
efforts = st.fixed_dictionaries(
    {
        "split_length": st.sampled_from([1, 2, 7, 30, 10**6]),
        "levels_left_out": st.integers(0, 2),
        "shares": st.sampled_from([(1, 1), (4, 2), (16, 8)]),
        "block_shares": st.sampled_from([1, 4]),
        "block_parts": st.sampled_from([1, 2, 8]),
        "cell": st.sampled_from([8, 16]),
        "most_regions": st.sampled_from([1, 3, 1 << 15]),
        "most_columns": st.sampled_from([1, 9, 1 << 30]),
        "slice_factors": st.sampled_from([(1,), (1, 2, 4, 8, 16)]),
    }
)


@settings(max_examples=30)
@given(
    mesh=meshes,
    shape=st.tuples(*[st.integers(1, 34)] * 3),
    seed=strategies.seeds,
    turned=st.booleans(),
    effort=efforts,
    # Of what is used where there is plenty, so that it may run out anywhere.
    room=st.floats(0.05, 1.1),
)
def test_against_the_brute_force(mesh, shape, seed, turned, effort, room):
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
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    with plan_override(method="cells", **effort):
        with watching(lambda work: used_by_pass.append(entries_used(work))):
            plenty = index.signed_distance_map(grid).values
        with plan_override(pool_entries=max(CHUNK, int(room * max(used_by_pass)))):
            scarce = index.signed_distance_map(grid).values
    centres = grid.points().reshape(-1, 3).numpy()
    limit = torch.from_numpy(8 * ROUNDING * scale_of(mesh.vertices, mesh.faces, centres)).reshape(grid.shape)
    assert ((plenty.abs() - scarce.abs()).abs() <= limit).all()
    some = rng.permutation(len(centres))[:400]
    assert_exact(mesh.vertices, mesh.faces, centres[some], scarce.reshape(-1)[torch.from_numpy(some)])
