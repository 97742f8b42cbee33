"""Maps of thick slices on a CPU: measured on a finer grid, the same values in the same places."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
import sdm.engine.ops
from sdm.bench.common.meshes import load_case
from sdm.engine.plan_override import plan_override
from sdm.engine.thick_slices import Slices, finer
from tests.helpers.exactness import ROUNDING, assert_exact, scale_of

# Across a mesh that is 2 wide: 100 and 13 slices.
THIN, THICK = 0.02, 0.15
TURN = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]


def test_as_many_as_make_cells_narrow():
    fine = Slices((THIN, THIN, THICK), (96, 96, 19), 0)
    assert finer(fine, 1.0, 20_000) == (1, 1, 4)
    assert finer(Slices((THICK, THIN, THIN), (19, 96, 96), 0), 1.0, 20_000) == (4, 1, 1)
    # A mesh twice as large, and slabs of the same grid.
    assert finer(fine, 0.5, 20_000) == (1, 1, 2)
    assert finer(Slices(fine.spacing, (32, 96, 19), 64), 1.0, 20_000) == (1, 1, 4)
    assert finer(Slices(fine.spacing, (1, 96, 19), 96), 1.0, 20_000) == (1, 1, 4)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_of_one_slice_is_as_wide_as_a_point(axis):
    shape, spacing = [96, 96, 96], [THIN] * 3
    shape[axis], spacing[axis] = 1, 100.0
    assert finer(Slices(tuple(spacing), tuple(shape), 0), 1.0, 20_000) == (1, 1, 1)
    other = (axis + 1) % 3
    spacing[other] = THICK
    assert finer(Slices(tuple(spacing), tuple(shape), 0), 1.0, 20_000)[other] == 4


@pytest.mark.parametrize(
    "slices",
    [
        Slices((THIN,) * 3, (96, 96, 96), 0),
        # Too many more voxels: all axes are coarse.
        Slices((THICK,) * 3, (20, 20, 20), 0),
        # Slices so thick that a sixteenth is still wide.
        Slices((THIN, THIN, 100 * THICK), (96, 96, 3), 0),
        Slices((THICK, THIN, THIN), (2**28, 96, 96), 0),
        Slices((THIN, THIN, float("nan")), (96, 96, 19), 0),
    ],
)
def test_none_where_it_would_not_be_faster(slices):
    assert finer(slices, 1.0, 20_000) == (1, 1, 1)


def test_none_for_few_triangles_or_long_lists():
    assert finer(Slices((THIN, THIN, THICK), (96, 96, 19), 0), 1.0, 100) == (1, 1, 1)
    # A thousand and more triangles to a cell.
    assert finer(Slices((THIN, THIN, THICK), (28, 28, 19), 0), 1.0, 100_000) == (1, 1, 1)


def test_none_where_all_is_searched():
    assert finer(Slices((THIN, THIN, THICK), (96, 96, 19), 0), 1.0, 10**8) == (1, 1, 1)


def grid_of(axis: int, turn: np.ndarray) -> sdm.Grid:
    """45 voxels and 9 or so slices through a mesh of size 2, off its middle."""
    spacing, shape = np.full(3, 0.05), np.full(3, 45)
    spacing[axis], shape[axis] = 0.3, 9
    return sdm.Grid([0.03, -0.02, 0.011] - turn @ (spacing * (shape - 1) / 2), spacing, shape, turn)


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, ...]]:
    """Factors by which slices were refined, by each call for one slab of one mesh or a batch."""
    calls = []
    finer_one = sdm.engine.ops.measured_finer

    def spy(*inputs):
        calls.append(inputs[2])
        return finer_one(*inputs)

    monkeypatch.setattr(sdm.engine.ops, "measured_finer", spy)
    return calls


def both_ways(mesh: sdm.TriangleMesh, grid: sdm.Grid) -> tuple[sdm.SDM, sdm.SDM]:
    """On a finer grid, in several slabs, and one search a voxel."""
    with plan_override(slab_voxels=1):
        found = sdm.signed_distance_map(mesh, grid, device="cpu")
    with plan_override(method="search"):
        return found, sdm.signed_distance_map(mesh, grid, device="cpu")


@pytest.mark.parametrize("name", ["torus-2000", "open hemisphere", "overlapping shells", "random soup"])
@pytest.mark.parametrize(("axis", "turn"), [(0, TURN), (1, np.eye(3)), (2, TURN)], ids=["0 turned", "1", "2 turned"])
def test_the_same_map(measured, name, axis, turn):
    case = load_case(name)
    mesh, grid = sdm.TriangleMesh(case.vertices, case.faces), grid_of(axis, turn)
    found, searched = both_ways(mesh, grid)
    assert [max(times) > 1 for times in measured] == [True]
    centres = grid.points().reshape(-1, 3).numpy()
    limit = torch.from_numpy(8 * ROUNDING * scale_of(case.vertices, case.faces, centres)).reshape(grid.shape)
    assert ((found.values.abs() - searched.values.abs()).abs() <= limit).all()
    assert torch.equal(found.values < 0, searched.values < 0)
    assert found.ambiguous_voxels == searched.ambiguous_voxels
    some = np.random.default_rng(0).permutation(len(centres))[:300]
    assert_exact(case.vertices, case.faces, centres[some], found.values.reshape(-1)[torch.from_numpy(some)])


def test_a_mesh_that_leaves_inside_unclear(measured):
    """Ambiguous voxels are counted of those that are kept, once each."""
    case = load_case("open hemisphere")
    found, searched = both_ways(sdm.TriangleMesh(case.vertices, case.faces), grid_of(2, np.eye(3)))
    assert found.ambiguous_voxels == searched.ambiguous_voxels > 0
    assert measured


@pytest.mark.parametrize("axis", [0, 2])
def test_slabs_are_the_whole_bit_for_bit(measured, axis):
    case = load_case("torus-2000")
    index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), "cpu")
    shape, spacing = [100, 30, 30], [0.02, 0.08, 0.08]
    shape[axis], spacing[axis] = (100, 0.17) if axis == 0 else (12, 0.2)
    grid = sdm.Grid(-np.array(spacing) * (np.array(shape) - 1) / 2, spacing, shape)
    whole = index.signed_distance_map(grid).values
    slabs = list(index.slabs(grid, max_bytes=1))
    assert len(slabs) == 4
    assert len(measured) == 5
    assert len(set(measured)) == 1
    assert torch.equal(torch.cat([values for _, _, values in slabs]), whole)


def test_a_map_does_not_depend_on_the_rest_of_its_batch(measured):
    """Bit for bit: meshes of several sizes, whose slices are thick, thin, and too thick."""
    case, grid = load_case("torus"), grid_of(2, np.eye(3))
    vertices = np.stack([size * case.vertices for size in (1.0, 20.0, 0.3, 0.01)])
    together = sdm.signed_distance_maps(vertices, case.faces, grid, device="cpu")
    assert len(set(measured)) > 0
    assert len(measured) < len(vertices)
    for one, values in zip(vertices, together, strict=True):
        assert torch.equal(sdm.signed_distance_maps(one[None], case.faces, grid, device="cpu")[0], values)


def test_large_sections_are_left_as_they_are():
    """32 layers of the finer grid would take more than 128 MiB."""
    wanted = {100: 4, 200: 2, 300: 1}
    for n, times in wanted.items():
        assert finer(Slices((THIN, THIN, THICK), (40, 2000, n), 0), 1.0, 20_000) == (1, 1, times)


def test_batches_and_gradients(measured):
    case = load_case("torus")
    grid = grid_of(2, np.eye(3))
    vertices = np.stack([case.vertices, 0.9 * case.vertices, 0.7 * case.vertices])
    batch = torch.tensor(vertices, requires_grad=True)
    maps = sdm.signed_distance_maps(batch, case.faces, grid, device="cpu")
    # All of them at once, as all want the same.
    assert len(measured) == 1
    maps.square().sum().backward()
    gradient = batch.grad
    for one, values in zip(vertices, maps.detach(), strict=True):
        alone = sdm.signed_distance_map(sdm.TriangleMesh(one, case.faces), grid, device="cpu").values
        assert (values - alone).abs().max() <= 8 * ROUNDING * 2
    batch.grad = None
    with plan_override(method="search"):
        sdm.signed_distance_maps(batch, case.faces, grid, device="cpu").square().sum().backward()
    assert gradient is not None
    assert batch.grad is not None
    torch.testing.assert_close(gradient, batch.grad, rtol=1e-3, atol=1e-3)
