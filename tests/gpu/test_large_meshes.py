"""Large meshes: a soup that is all boundary, a fine torus, a map of a hundred million voxels in slabs."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case
from sdm.engine.plan_override import plan_override
from sdm.kernels.dense.counters import SPLIT_CELLS
from tests.helpers.exactness import ROUNDING, assert_exact
from tests.helpers.watch_measuring import watching

pytestmark = pytest.mark.gpu


def test_a_soup_of_200_000_triangles():
    rng = np.random.default_rng(1)
    count = 200_000
    corner = rng.uniform(-1, 1, (count, 1, 3)) + 10.0 ** rng.uniform(-4, -1, (count, 1, 1)) * rng.normal(
        size=(count, 3, 3)
    )
    vertices = corner.reshape(-1, 3).astype(np.float32)
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    points = rng.uniform(-1.5, 1.5, (50_000, 3)).astype(np.float32)
    mesh = sdm.TriangleMesh(vertices, faces)
    gpu = sdm.MeshIndex(mesh, "cuda")
    values = gpu.signed_distance(points).cpu()
    assert_exact(vertices, faces, points[:60], values[:60])
    cpu = sdm.MeshIndex(mesh, "cpu")
    some = points[:3000]
    assert (cpu.signed_distance(some).abs() - values[:3000].abs()).abs().max() <= 4 * ROUNDING * 2
    winding = cpu.winding_number(some)
    sure = (winding - 0.5).abs() > 2e-3
    assert torch.equal((values[:3000] < 0)[sure], (winding > 0.5)[sure])


def test_a_torus_of_a_million_triangles():
    """Against the formula of a torus: chords leave arcs by no more than their sagittas, 5e-6 each."""
    case = load_case("torus-1000000")
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    points = np.random.default_rng(2).uniform(-1, 1, (1_000_000, 3)).astype(np.float32)
    values = sdm.signed_distance(mesh, points, device="cuda").cpu().double().numpy()
    x, y, z = points.astype(np.float64).T
    expected = np.hypot(np.hypot(x, y) - 0.65, z) - 0.25
    assert np.abs(values - expected).max() < 2e-5
    clear = np.abs(expected) > 2e-5
    assert ((values < 0) == (expected < 0))[clear].all()


def test_splits_that_find_no_room():
    """Of a long list that several groups measure each has a part: where one finds no room, the others are not all."""
    case = load_case("torus-300000")
    index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), "cuda")
    shape = np.array([96, 72, 48])
    spacing = 2.1 / (shape - 1)
    turn, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    grid = sdm.Grid(-turn @ (spacing * (shape - 1) / 2), spacing, shape, turn)
    with plan_override(method="search"):
        expected = index.signed_distance_map(grid).values
    lacking = []

    def look(work):
        split_cells = work.schedule.split_cells.numpy()[: work.counters.numpy()[SPLIT_CELLS]]
        lacking.append(int(work.schedule.lacking.numpy()[split_cells].sum()))

    for most in (1 << 27, 1 << 24, 1 << 22, 3 << 20, 1 << 20, 1 << 17):
        # A replayed recording would not be looked at.
        with plan_override(method="cells", pool_entries=most), sdm.cuda_graphs.paused(), watching(look):
            values = index.signed_distance_map(grid).values
        assert (values.abs() - expected.abs()).abs().max() <= 8 * ROUNDING * 2
        assert torch.equal(values < 0, expected < 0)
    # With plenty there is room for all.
    assert lacking[0] == 0
    assert sum(lacking) > 0


def test_a_map_in_slabs_takes_little_memory():
    case = load_case("torus-20000")
    index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), "cuda")
    grid = sdm.Grid([-1, -1, -1], [2 / 511] * 3, [512, 512, 400])
    for _ in index.slabs(sdm.Grid(grid.origin, grid.spacing, [8, 512, 400]), 1 << 24):
        pass
    torch.cuda.synchronize()
    torch.cuda.reset_peak_memory_stats()
    before = torch.cuda.memory_allocated()
    inside = 0
    for _, _, values in index.slabs(grid, 1 << 24):
        inside += int((values < 0).sum())
    # One slab at a time, the slab before it, and the lists' memory, whatever the grid.
    assert torch.cuda.max_memory_allocated() - before < 400 << 20
    volume = 2 * np.pi**2 * 0.65 * 0.25**2
    assert inside * (2 / 511) ** 3 == pytest.approx(volume, rel=2e-3)


def test_a_map_of_1024_voxels_a_side_is_that_of_its_slabs():
    """It has 4 GiB, more than an array's 32-bit strides hold."""
    case = load_case("torus-20000")
    index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), "cuda")
    grid = sdm.Grid([-1, -1, -1], [2 / 1023] * 3, [1024] * 3)
    values = index.signed_distance_map(grid).values
    for begin, end, slab in index.slabs(grid, 1 << 27):
        assert torch.equal(values[begin:end], slab)
