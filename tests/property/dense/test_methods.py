"""Both ways to compute a map, by lists of triangles for cells of voxels and by one search a voxel, and hard cases."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import cube, load_case, sphere
from sdm.engine.plan_override import plan_override
from tests.helpers import strategies
from tests.helpers.exactness import ROUNDING, assert_exact, scale_of

meshes = st.one_of(strategies.soups(40), strategies.slivers(), strategies.closed(), strategies.shells())
METHODS = ["cells", "search"]
# Cells of thick slices, as they are and on a grid that is finer.
WAYS = {
    "thick cells": {"method": "cells", "slice_factors": (1,)},
    "cells": {"method": "cells"},
    "search": {"method": "search"},
}


@pytest.mark.parametrize("way", WAYS)
@settings(max_examples=30)
@given(mesh=strategies.anywhere(meshes), shape=st.tuples(*[st.integers(1, 19)] * 3), seed=strategies.seeds)
def test_against_the_brute_force(way, mesh, shape, seed):
    rng = np.random.default_rng(seed)
    used = mesh.vertices[mesh.faces].astype(np.float64)
    low, high = used.min((0, 1)), used.max((0, 1))
    size = max(float((high - low).max()), 1e-3 * float(np.abs(used).max())) or 1.0
    # From much finer than the mesh to much coarser, and somewhere about it.
    spacing = size * 10.0 ** rng.uniform(-4, 0.5, 3) * [1, 0.7, 1.3]
    middle = rng.uniform(low, high + 1e-3 * size)
    grid = sdm.Grid(middle - spacing * (np.array(shape) - 1) / 2, spacing, shape)
    with plan_override(**WAYS[way]):
        field = sdm.signed_distance_map(sdm.TriangleMesh(*mesh), grid, device="cpu")
    centres = grid.points().reshape(-1, 3).numpy()
    some = rng.permutation(len(centres))[:400]
    assert_exact(mesh.vertices, mesh.faces, centres[some], field.values.reshape(-1)[torch.from_numpy(some)])


@pytest.mark.parametrize("name", ["nested shells", "needle fan", "random soup", "tiny beside huge", "loose slivers"])
def test_same_values(name):
    case = load_case(name)
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    grid = sdm.Grid.around(mesh, resolution=40)
    centres = grid.points().reshape(-1, 3).numpy()
    some = np.random.default_rng(0).permutation(len(centres))[:1000]
    maps = []
    for method in METHODS:
        with plan_override(method=method):
            maps.append(sdm.signed_distance_map(mesh, grid, device="cpu").values)
        assert_exact(case.vertices, case.faces, centres[some], maps[-1].reshape(-1)[torch.from_numpy(some)])
    limit = torch.from_numpy(8 * ROUNDING * scale_of(case.vertices, case.faces, centres)).reshape(grid.shape)
    assert ((maps[0].abs() - maps[1].abs()).abs() <= limit).all()
    assert torch.equal(maps[0] < 0, maps[1] < 0)


def test_when_the_pool_of_lists_runs_out():
    """Cells that find it empty are searched voxel by voxel: never wrong."""
    case = load_case("overlapping shells")
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    index = sdm.MeshIndex(mesh, "cpu")
    grid = sdm.Grid.around(mesh, resolution=40)
    with plan_override(method="cells"):
        plenty = index.signed_distance_map(grid).values
    for room in (1 << 13, 1 << 14, 1 << 16):
        with plan_override(method="cells", pool_entries=room):
            scarce = index.signed_distance_map(grid).values
        assert (plenty.abs() - scarce.abs()).abs().max() <= 4 * ROUNDING * 2
        assert torch.equal(plenty < 0, scarce < 0)


@pytest.mark.parametrize("name", ["cube", "nested shells", "open hemisphere", "overlapping shells", "tiny beside huge"])
def test_large_triangles_are_the_work_of_many(name):
    """Winding numbers, and so signs, are the same whoever goes through a triangle's columns."""
    case = load_case(name)
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    index, grid = sdm.MeshIndex(mesh, "cpu"), sdm.Grid.around(mesh, resolution=40)
    maps = []
    for most in (1 << 30, 9, 1):
        with plan_override(most_columns=most):
            maps.append(index.signed_distance_map(grid).values)
    assert (maps[0] < 0).any()
    assert all(torch.equal(maps[0], other) for other in maps[1:])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("step", [1e-8, 1e-5, 1e-2])
def test_every_triangle_in_every_list(method, step):
    """Around the centre of a sphere all its triangles are as near as each other."""
    vertices, faces = sphere(24)
    turn, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    vertices = (vertices @ turn).astype(np.float32)
    grid = sdm.Grid([-4 * step] * 3, [step, 0.9 * step, 1.1 * step], [9, 10, 8])
    with plan_override(method=method):
        field = sdm.signed_distance_map(sdm.TriangleMesh(vertices, faces), grid, device="cpu")
    centres = grid.points().reshape(-1, 3).numpy()
    assert_exact(vertices, faces, centres[::3], field.values.reshape(-1)[::3])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("mesh_size", "grid_size"), [(1, 1e20), (1e-20, 1), (1e-30, 1e8), (1e-40, 1e-39), (1e28, 1e-8), (1e-38, 8e29)]
)
def test_sizes_far_apart(method, mesh_size, grid_size):
    vertices, faces = cube()
    grid = sdm.Grid([-4 * grid_size] * 3, [grid_size * 1.03] * 3, [9, 9, 9])
    mesh = sdm.TriangleMesh((vertices * mesh_size).astype(np.float32), faces)
    with plan_override(method=method):
        values = sdm.signed_distance_map(mesh, grid, device="cpu").numpy()
    centres = grid.points().double().numpy()
    outside = np.abs(centres) - float(mesh.vertices[-1, 0])
    expected = np.linalg.norm(np.maximum(outside, 0), axis=-1) + np.minimum(outside.max(-1), 0)
    scale = np.maximum(np.abs(centres).max(-1), mesh_size)
    assert (np.abs(values - expected) <= 4 * ROUNDING * scale + 3e-45).all()


def test_a_finer_grid_than_float32():
    """Voxels whose centres round to the same point have the same value, and nothing takes for ever."""
    vertices, faces = cube()
    grid = sdm.Grid([1000, 1000, 1000], [1e-7] * 3, [40, 40, 40])
    values = sdm.signed_distance_map(sdm.TriangleMesh(vertices + 1000, faces), grid, device="cpu").values
    assert values.unique().numel() == 1
    assert float(values[0, 0, 0]) == -1
