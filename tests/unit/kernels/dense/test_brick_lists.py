"""Bricks with lists of their own: the bits of one list that they share, whoever makes them and wherever they end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.degenerate_meshes import needle_fan
from sdm.bench.common.meshes import load_case, sphere
from sdm.engine.plan_override import plan_override
from sdm.kernels.dense import cost_model
from sdm.kernels.dense.counters import COARSE, MORE_SPLITS, WHOLE
from sdm.kernels.dense.workspace import Workspace
from tests.helpers.exactness import assert_exact
from tests.helpers.same_bits import assert_same_bits
from tests.helpers.watch_measuring import entries_used, watching

NAMES = ["overlapping shells", "random soup", "needle fan", "all alike", "cube"]
# As no list is cut.
WHOLE_LISTS = 10**6


def mesh_of(name: str) -> sdm.TriangleMesh:
    if name == "needle fan":
        return sdm.TriangleMesh(*needle_fan(300))
    if name == "all alike":
        # About the centre every triangle is as near as any.
        vertices, faces = sphere(24)
        turn, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
        return sdm.TriangleMesh((vertices @ turn).astype(np.float32), faces)
    case = load_case(name)
    return sdm.TriangleMesh(case.vertices, case.faces)


def fine_grid(mesh: sdm.TriangleMesh, *shape: int) -> sdm.Grid:
    """A grid in the middle of a mesh, whose voxels are so small that no cell is coarse."""
    low, size = mesh.numpy()[0].min(0), float(np.ptp(mesh.numpy()[0], 0).max())
    return sdm.Grid(low + 0.3 * size, [size / 200] * 3, shape)


def grids_of(mesh: sdm.TriangleMesh) -> list[sdm.Grid]:
    """Grids that end anywhere in cells and bricks: around the mesh, beside it, far away, turned, with long voxels."""
    low, size = mesh.numpy()[0].min(0), float(np.ptp(mesh.numpy()[0], 0).max())
    turn, _ = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))
    return [
        sdm.Grid.around(mesh, resolution=44),
        fine_grid(mesh, 37, 30, 41),
        sdm.Grid(low - 9.0 * size, [size / 30] * 3, [17, 9, 33]),
        sdm.Grid(low + 0.2 * size, [size / 90, size / 60, size / 200], [34, 25, 40], turn),
    ]


def values_of(mesh: sdm.TriangleMesh, grid: sdm.Grid, **options: Any) -> torch.Tensor:
    """A map planned with these options, of cells of 16^3 voxels."""
    with plan_override(cell=16, **options):
        return sdm.signed_distance_map(mesh, grid, device="cpu").values


class Seen:
    """Counts of a pass after stage 5: blocks, and splits that were asked for beyond each list's first."""

    def __init__(self) -> None:
        self.entries: list[int] = []
        self.whole: list[int] = []
        self.coarse: list[int] = []
        self.more: list[int] = []
        self.room: list[int] = []

    def look(self, work: Workspace) -> None:
        counts = work.counters.numpy()
        whole, coarse = int(counts[WHOLE:].sum()), int(counts[COARSE])
        self.whole.append(whole)
        self.coarse.append(coarse)
        self.more.append(int(counts[MORE_SPLITS]))
        self.room.append(int(work.schedule.more))
        # Of cells that are measured by bricks: one list for each, or one that they share.
        lists = slice(8 * coarse, 8 * coarse + (8 if work.grid.by_brick else 1) * whole)
        self.entries.append(int((work.blocks.lengths.numpy()[lists]).sum()))


@pytest.fixture
def seen() -> Iterator[Seen]:
    """Only the fast path, and a look at its lists."""
    found = Seen()
    with plan_override(method="cells", slice_factors=(1,)), watching(found.look):
        yield found


@pytest.mark.parametrize("shares", [None, (8, 4)])
@pytest.mark.parametrize("name", NAMES)
def test_lists_by_brick_change_no_bit(seen, name, shares):
    """Whole or in splits, each of which makes chains of its own, some of which or all are measured together."""
    mesh = mesh_of(name)
    for number, grid in enumerate(grids_of(mesh)):
        plain = values_of(mesh, grid, by_brick=False, shares=shares)
        for splits in ((WHOLE_LISTS, WHOLE_LISTS), (1, WHOLE_LISTS), (7, 7), (1, 3))[0 if shares is None else 2 :]:
            options = dict(zip(("list_split", "split_length"), splits, strict=True))
            values = values_of(mesh, grid, by_brick=True, shares=shares, **options)
            assert_same_bits(values, plain, (number, splits))
    assert max(seen.whole) > 0
    assert max(seen.coarse) > 0


@pytest.mark.parametrize("name", ["overlapping shells", "all alike"])
def test_bricks_are_asked_for_few_features(seen, name):
    """Together the eight lists are far shorter than eight times the one that bricks would share."""
    mesh = mesh_of(name)
    grid = fine_grid(mesh, 64, 64, 64)
    values_of(mesh, grid, by_brick=False)
    values_of(mesh, grid, by_brick=True)
    shared, own = seen.entries
    assert shared <= own < 4 * shared


def test_lists_are_split_as_far_as_there_is_room(seen):
    mesh = mesh_of("overlapping shells")
    grid = fine_grid(mesh, 60, 50, 40)
    plain = values_of(mesh, grid, by_brick=True, list_split=WHOLE_LISTS)
    cells = seen.whole[-1]
    assert seen.more[-1] == 0
    values = values_of(mesh, grid, by_brick=True, list_split=1)
    # More was asked for than there is room for, and so much was had.
    assert seen.more[-1] > seen.room[-1] > 0
    assert cells < seen.whole[-1] <= cells + seen.room[-1]
    assert_same_bits(values, plain, "split")


@pytest.mark.parametrize("name", ["overlapping shells", "needle fan"])
def test_coarse_cells_have_lists_as_before(seen, name):
    """Their bricks look for witnesses of their own, and are searched where they are coarse themselves."""
    mesh = mesh_of(name)
    for resolution in (26, 41):
        grid = sdm.Grid.around(mesh, resolution=resolution)
        plain = values_of(mesh, grid, by_brick=False)
        for split_length, list_bricks in ((WHOLE_LISTS, False), (3, False), (3, True)):
            values = values_of(mesh, grid, by_brick=True, split_length=split_length, list_bricks=list_bricks)
            assert_same_bits(values, plain, (resolution, split_length, list_bricks))
    assert max(seen.coarse) > 0


@pytest.mark.parametrize("splits", [(4, WHOLE_LISTS), (2, 4), (WHOLE_LISTS, WHOLE_LISTS)])
@pytest.mark.parametrize("name", ["overlapping shells", "random soup"])
def test_bricks_whose_lists_find_no_room_are_searched(seen, name, splits):
    """Pools of every size, so that any chain of any brick is the last that finds room."""
    options = dict(zip(("list_split", "split_length"), splits, strict=True))
    mesh = mesh_of(name)
    grid = fine_grid(mesh, 34, 20, 37)
    plenty = values_of(mesh, grid, by_brick=True, **options)
    centres = grid.points().reshape(-1, 3)
    differ = 0
    for step in range(0, 34, 5):
        scarce = values_of(mesh, grid, by_brick=True, pool_entries=int(2048 * 1.25**step), **options)
        assert torch.equal(plenty < 0, scarce < 0)
        other = (plenty.view(torch.int32) != scarce.view(torch.int32)).reshape(-1).nonzero()[:50, 0]
        differ += len(other)
        if len(other):
            assert_exact(*mesh.numpy(), centres[other].numpy(), scarce.reshape(-1)[other])
    # Searches round otherwise, so some was searched.
    assert differ > 0


@pytest.mark.parametrize("levels", [1, 2])
def test_lists_of_larger_leaves_by_brick(seen, levels):
    mesh = mesh_of("overlapping shells")
    grid = fine_grid(mesh, 40, 34, 37)
    plain = values_of(mesh, grid, by_brick=False, levels_left_out=levels)
    for split_length in (WHOLE_LISTS, 5):
        values = values_of(mesh, grid, by_brick=True, levels_left_out=levels, list_split=split_length)
        assert_same_bits(values, plain, split_length)


def test_meshes_of_a_batch_have_the_bits_of_each_alone(seen):
    mesh = mesh_of("overlapping shells")
    grid = fine_grid(mesh, 37, 40, 34)
    turned = torch.stack([mesh.vertices, mesh.vertices[:, [1, 2, 0]], mesh.vertices[:, [2, 0, 1]]])
    with plan_override(cell=16, by_brick=True, list_split=5, split_length=10):
        maps = sdm.signed_distance_maps(turned, mesh.faces, grid)
        for vertices, values in zip(turned, maps, strict=True):
            alone = sdm.signed_distance_map(sdm.TriangleMesh(vertices, mesh.faces), grid, device="cpu").values
            assert_same_bits(values, alone, "batch")
    with plan_override(cell=16, by_brick=False):
        assert_same_bits(sdm.signed_distance_maps(turned, mesh.faces, grid), maps, "one list")


def test_meshes_that_differ_have_the_bits_of_each_alone(seen):
    meshes = [mesh_of(name) for name in ("overlapping shells", "cube", "all alike")]
    grids = [
        fine_grid(mesh, *shape) for mesh, shape in zip(meshes, ((37, 20, 34), (50, 50, 50), (9, 8, 20)), strict=True)
    ]
    with plan_override(cell=16, by_brick=True, list_split=5, split_length=10):
        maps = sdm.signed_distance_maps(meshes, grids, device="cpu")
        for mesh, grid, found in zip(meshes, grids, maps, strict=True):
            assert_same_bits(found.values, values_of(mesh, grid, by_brick=True), len(mesh))


def test_passes_of_few_regions_change_no_bit(seen):
    mesh = mesh_of("overlapping shells")
    grid = fine_grid(mesh, 70, 60, 50)
    plain = values_of(mesh, grid, by_brick=True)
    values = values_of(mesh, grid, by_brick=True, most_regions=5, list_split=9)
    assert len(seen.whole) > 2
    assert_same_bits(values, plain, "passes")


@pytest.mark.parametrize("name", ["overlapping shells", "cube"])
def test_closest_points_by_lists_of_bricks(name):
    """The winner of several features at one distance does not depend on where it stands in a list."""
    mesh = mesh_of(name)
    grid = fine_grid(mesh, 37, 30, 41)
    found = []
    for by_brick in (False, True):
        with plan_override(method="cells", cell=16, by_brick=by_brick, list_split=5, slice_factors=(1,)):
            found.append(sdm.signed_distance_map(mesh, grid, device="cpu", return_closest=True))
    (one, hit), (other, by_bricks) = found
    assert_same_bits(other.values, one.values, name)
    assert torch.equal(hit.faces, by_bricks.faces)
    assert_same_bits(by_bricks.points, hit.points, name)


@pytest.mark.parametrize("name", ["overlapping shells", "all alike"])
def test_narrow_bands_by_lists_of_bricks(name):
    mesh = mesh_of(name)
    spacing = float(np.ptp(mesh.numpy()[0], 0).max()) / 100
    found = []
    for by_brick in (False, True):
        with plan_override(method="cells", cell=16, by_brick=by_brick, list_split=5, slice_factors=(1,)):
            found.append(sdm.narrow_band(mesh, spacing, half_width=3.0, device="cpu"))
    one, other = found
    assert torch.equal(one.blocks, other.blocks)
    assert_same_bits(other.values, one.values, name)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("voxels", [(60, 60, 60), (60, 24, 60)])
def test_the_room_that_is_expected_is_enough(turned, voxels):
    """Also where voxels are long, or the grid is turned, so that the boxes around its cells are wider."""
    case = load_case("torus-20000")
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    shape = np.array(voxels)
    spacing = 2.1 / (shape - 1)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0] if turned else np.eye(3)
    grid = sdm.Grid(-turn @ (spacing * (shape - 1) / 2), spacing, shape, turn)
    used: list[int] = []
    with plan_override(method="cells", slice_factors=(1,)), watching(lambda work: used.append(entries_used(work))):
        values_of(mesh, grid, by_brick=True, list_split=128)
    regions = int(np.prod(-(-shape // 32)))
    expected = cost_model.expected_entries(len(case.faces), voxels, 16, 1, 1, by_brick=True) * regions
    assert sum(used) <= expected * cost_model.uneven_room(spacing.tolist(), turned)
