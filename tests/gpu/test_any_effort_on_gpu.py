"""The fast path on a GPU against one search a voxel, on grids of every kind, wherever the pool of lists runs out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import load_case, sphere
from sdm.engine.plan_override import plan_override
from sdm.kernels.dense.chunk_pool import CHUNK
from tests.helpers import strategies
from tests.helpers.exactness import ROUNDING, scale_of
from tests.helpers.same_bits import assert_same_bits
from tests.helpers.watch_measuring import entries_used, watching

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
    with plan_override(method="search"):
        expected = index.signed_distance_map(grid).values
    # A replayed recording would not be looked at.
    with plan_override(method="cells"), sdm.cuda_graphs.paused():
        with watching(lambda work: entries.append(entries_used(work))):
            plenty = index.signed_distance_map(grid).values
        with plan_override(pool_entries=max(CHUNK, int(room * max(entries)))):
            little = index.signed_distance_map(grid).values
    centres = grid.points().reshape(-1, 3).numpy()
    limit = torch.from_numpy(8 * ROUNDING * scale_of(mesh.vertices, mesh.faces, centres)).reshape(grid.shape).cuda()
    sure = expected.abs() > limit
    for values in (plenty, little):
        assert ((values.abs() - expected.abs()).abs() <= limit).all()
        assert torch.equal((values < 0)[sure], (expected < 0)[sure])


# Lists of bricks of cells of 16^3 voxels, where groups of lanes share the work.
ONE_LIST = {"by_brick": False}
# Whole lists, and splits of which all or some are measured together.
BY_BRICK = ({}, {"list_split": 32}, {"list_split": 32, "split_length": 128}, {"list_split": 64, "split_length": 64})


def map_of_wide_cells(mesh: sdm.TriangleMesh, grid: sdm.Grid, **options: Any) -> torch.Tensor:
    with plan_override(method="cells", cell=16, **options):
        return sdm.signed_distance_map(mesh, grid, device="cuda").values


@pytest.mark.parametrize("resolution", [96, 219])
@pytest.mark.parametrize("name", ["torus-20000", "torus-300000", "overlapping shells", "random soup"])
def test_lists_by_brick_have_the_bits_of_one_list(name, resolution):
    case = load_case(name)
    mesh = sdm.TriangleMesh(torch.from_numpy(case.vertices).cuda(), torch.from_numpy(case.faces).cuda())
    grid = sdm.Grid.around(mesh, resolution=resolution)
    plain = map_of_wide_cells(mesh, grid, **ONE_LIST)
    for options in BY_BRICK:
        # Made by hand at first, and replayed in the end.
        for _ in range(5):
            assert_same_bits(map_of_wide_cells(mesh, grid, by_brick=True, **options), plain, options)


def test_a_batch_by_brick_has_the_bits_of_each_mesh_alone():
    case = load_case("torus-20000")
    vertices, faces = torch.from_numpy(case.vertices).cuda(), torch.from_numpy(case.faces).cuda()
    grid = sdm.Grid.around(sdm.TriangleMesh(vertices, faces), resolution=100)
    batch = torch.stack([vertices, vertices[:, [1, 2, 0]], 0.9 * vertices])
    with plan_override(method="cells", cell=16, by_brick=True, list_split=32):
        maps = sdm.signed_distance_maps(batch, faces, grid)
    for each, values in zip(batch, maps, strict=True):
        assert_same_bits(map_of_wide_cells(sdm.TriangleMesh(each, faces), grid, **ONE_LIST), values, "batch")
