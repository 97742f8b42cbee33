"""Map, scattered points, slabs and batch: four ways to the same numbers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
import sdm.engine.structure.sizes
from sdm.bench.common.meshes import load_case
from tests.helpers import oracle, strategies
from tests.helpers.exactness import ROUNDING, scale_of

meshes = st.one_of(strategies.soups(), strategies.slivers(), strategies.closed(), strategies.shells())
shapes = st.tuples(st.integers(1, 20), *[st.integers(1, 14)] * 2)


def _grid(shape: tuple[int, int, int], spacing: float) -> sdm.Grid:
    return sdm.Grid([-0.5 * spacing * (n - 1) for n in shape], [spacing, 0.75 * spacing, 1.25 * spacing], shape)


@settings(max_examples=30)
@given(meshes, shapes, st.sampled_from([0.25, 0.37, 1.0]))
def test_map_and_points(mesh, shape, spacing):
    grid = _grid(shape, spacing)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    dense = index.signed_distance_map(grid).values
    scattered = index.signed_distance(grid.points())
    centres = grid.points().reshape(-1, 3).numpy()
    limit = torch.from_numpy(4 * ROUNDING * scale_of(mesh.vertices, mesh.faces, centres)).reshape(shape)
    # Which of two nearly equidistant triangles is taken may differ, and either may be that far from the truth: a step
    # of float32 alone is 4.4 roundings where a distance is more than twice the largest coordinate.
    assert ((dense.abs() - scattered.abs()).abs() <= 2 * limit).all()
    winding = torch.from_numpy(oracle.winding_number(mesh.vertices, mesh.faces, centres)).reshape(shape)
    sure = ((winding - 0.5).abs() > 1e-5) & (dense.abs() > limit)
    assert torch.equal((dense < 0)[sure], (scattered < 0)[sure])


@settings(max_examples=24)
@given(meshes, shapes, st.integers(1, 70))
def test_slabs_and_map(mesh, shape, layers):
    grid = _grid(shape, 0.3)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    whole = index.signed_distance_map(grid).values
    begins = []
    # Slabs are made of whole regions, of up to 32 layers.
    layers = max(32, layers // 32 * 32)
    for begin, end, values in index.slabs(grid, 4 * layers * shape[1] * shape[2]):
        assert values.shape == (end - begin, *shape[1:])
        assert end - begin <= max(8, layers)
        assert torch.equal(values, whole[begin:end])
        begins.append(begin)
    assert begins == list(range(0, shape[0], layers))


@pytest.mark.parametrize("name", ["nested shells", "open hemisphere", "random soup", "needle fan"])
def test_slabs_of_larger_meshes(name):
    case = load_case(name)
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    index = sdm.MeshIndex(mesh, "cpu")
    grid = sdm.Grid.around(mesh, resolution=24)
    whole = index.signed_distance_map(grid).values
    for layers in (1, 8, 19):
        parts = [values for _, _, values in index.slabs(grid, layers * 4 * 24 * 24)]
        assert torch.equal(torch.cat(parts), whole)


@settings(max_examples=24)
@given(st.one_of(meshes), st.integers(1, 5), strategies.seeds)
def test_batch_and_single(mesh, count, seed):
    rng = np.random.default_rng(seed)
    moved = mesh.vertices + 0.3 * rng.normal(size=(count, *mesh.vertices.shape)) * rng.choice([0, 1], (count, 1, 1))
    moved = (moved * 10.0 ** rng.integers(-3, 4, (count, 1, 1))).astype(np.float32)
    grid = _grid((7, 6, 9), 0.4)
    batch = sdm.signed_distance_maps(moved, mesh.faces, grid, device="cpu")
    assert batch.shape == (count, *grid.shape)
    centres = grid.points().reshape(-1, 3).numpy()
    for values, vertices in zip(batch, moved, strict=True):
        single = sdm.signed_distance_map(sdm.TriangleMesh(vertices, mesh.faces), grid, device="cpu").values
        limit = torch.from_numpy(4 * ROUNDING * scale_of(vertices, mesh.faces, centres)).reshape(grid.shape)
        assert ((values.abs() - single.abs()).abs() <= limit).all()
        winding = torch.from_numpy(oracle.winding_number(vertices, mesh.faces, centres)).reshape(grid.shape)
        sure = ((winding - 0.5).abs() > 1e-5) & (single.abs() > limit)
        assert torch.equal((values < 0)[sure], (single < 0)[sure])


@pytest.mark.parametrize("boundary", [0, 1024])
def test_a_batch_of_soups(monkeypatch, boundary):
    monkeypatch.setattr(sdm.engine.structure.sizes, "MOST_BOUNDARY_EDGES", boundary)
    rng = np.random.default_rng(3)
    vertices = rng.normal(size=(4, 30, 3)).astype(np.float32)
    faces = rng.integers(0, 30, (50, 3)).astype(np.int32)
    grid = _grid((6, 7, 8), 0.5)
    batch = sdm.signed_distance_maps(vertices, faces, grid, device="cpu")
    for values, one in zip(batch, vertices, strict=True):
        single = sdm.signed_distance_map(sdm.TriangleMesh(one, faces), grid, device="cpu").values
        assert torch.equal(values, single)


def test_every_query_again_gives_the_same_bits():
    case = load_case("overlapping shells")
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    grid = sdm.Grid.around(mesh, resolution=32)
    first = sdm.signed_distance_map(mesh, grid, device="cpu").values
    index = sdm.MeshIndex(mesh, "cpu")
    points = grid.points().reshape(-1, 3)
    scattered = index.signed_distance(points)
    for _ in range(3):
        assert torch.equal(index.signed_distance_map(grid).values, first)
        assert torch.equal(index.signed_distance(points), scattered)
    # Enough points to be sorted, in another order.
    order = torch.from_numpy(np.random.default_rng(0).permutation(len(points)))
    again = index.signed_distance(points[order])
    torch.testing.assert_close(again, scattered[order], rtol=0, atol=2 * ROUNDING)
    assert torch.equal(again < 0, (scattered < 0)[order])
