"""Lists made by several groups and measured in splits: maps are right however the work is shared out."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false, reportOperatorIssue=false

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

import sdm
from sdm.bench.common.degenerate_meshes import needle_fan
from sdm.bench.common.meshes import load_case, sphere
from sdm.engine.plan_override import plan_override
from sdm.kernels.dense import cost_model
from sdm.kernels.dense.block_schedule import CELL_BITS, SPLIT_BITS, cell_of, split_of, splits_of
from sdm.kernels.dense.counters import COARSE, LENGTHS, SPLIT_CELLS, WHOLE
from sdm.kernels.dense.region_grid import BLOCK
from sdm.kernels.dense.workspace import Workspace
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import shrink
from tests.helpers.exactness import ROUNDING, assert_exact, scale_of
from tests.helpers.same_bits import assert_same_bits
from tests.helpers.watch_measuring import entries_used, watching

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _shrink(begin: int, values: wp.array(dtype=wp.float32), sizes: wp.array(dtype=wp.float32)):
    i = begin + wp.tid()
    shrink(values, i % values.shape[0], sizes[i])


@wp.kernel
def _decode(codes: wp.array(dtype=int), out: wp.array(dtype=wp.vec3i)):
    i = wp.tid()
    out[i] = wp.vec3i(cell_of(codes[i]), split_of(codes[i]), splits_of(codes[i]))


def decoded(codes: np.ndarray) -> np.ndarray:
    """Cell, split and splits (N,3) of each code."""
    out = wp.zeros(len(codes), dtype=wp.vec3i, device="cpu")
    wp.launch(_decode, len(codes), [wp.array(codes.astype(np.int32), dtype=int, device="cpu"), out], device="cpu")
    return out.numpy()


@dataclass
class Seen:
    """Schedules of a map's passes: codes of cells, and for each cell the lengths of its chains."""

    whole: list[np.ndarray] = field(default_factory=list)
    coarse: list[np.ndarray] = field(default_factory=list)
    lengths: list[np.ndarray] = field(default_factory=list)
    without_room: int = 0
    split_without_room: int = 0
    used: int = 0
    count: int = 0

    def codes(self) -> np.ndarray:
        """All of them: cell, split and splits (N,3)."""
        return np.concatenate([*self.whole, *self.coarse])

    def clear(self) -> None:
        self.whole, self.coarse, self.lengths = [], [], []


@pytest.fixture
def seen() -> Iterator[Seen]:
    """Only the fast path, and a look at its schedules."""
    found = Seen()

    def look(work: Workspace) -> None:
        counts = work.counters.numpy()
        piles = work.schedule.whole.numpy().reshape(LENGTHS, work.schedule.room)
        whole = decoded(np.concatenate([pile[:count] for pile, count in zip(piles, counts[WHOLE:], strict=True)]))
        coarse = decoded(work.schedule.coarse.numpy()[: counts[COARSE]])
        # Nothing is known of cells outside of the grid.
        scheduled = np.unique(np.concatenate([whole[:, 0], coarse[:, 0]]))
        found.whole.append(whole)
        found.coarse.append(coarse)
        found.lengths.append(work.cells.lengths.numpy().reshape(-1, work.cells.shares)[scheduled])
        found.without_room += int((work.cells.heads.numpy().reshape(-1, work.cells.shares)[scheduled] < 0).any(1).sum())
        # Of some cells only a part of the splits found none, so that what the others come to is not all.
        found.split_without_room += int(
            work.schedule.lacking.numpy()[work.schedule.split_cells.numpy()[: counts[SPLIT_CELLS]]].sum()
        )
        found.used += entries_used(work)
        found.count += work.grid.count

    with plan_override(method="cells", slice_factors=(1,)), watching(look):
        yield found


NAMES = ["overlapping shells", "random soup", "needle fan"]


def mesh_of(name: str) -> sdm.TriangleMesh:
    if name == "all alike":
        # About the centre every triangle is as near as any.
        vertices, faces = sphere(24)
        turn, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
        return sdm.TriangleMesh((vertices @ turn).astype(np.float32), faces)
    if name == "needle fan":
        return sdm.TriangleMesh(*needle_fan(300))
    case = load_case(name)
    return sdm.TriangleMesh(case.vertices, case.faces)


def grid_of(name: str, mesh: sdm.TriangleMesh) -> sdm.Grid:
    return (
        sdm.Grid([-0.1] * 3, [0.012] * 3, [17, 18, 20]) if name == "all alike" else sdm.Grid.around(mesh, resolution=26)
    )


def values_of(mesh: sdm.TriangleMesh, grid: sdm.Grid, **options: Any) -> torch.Tensor:
    """A map planned with these options."""
    with plan_override(**options):
        return sdm.signed_distance_map(mesh, grid, device="cpu").values


def shared(shares: int) -> dict[str, tuple[int, int]]:
    """As many groups for each list on this CPU as a GPU might have."""
    return {} if shares == 1 else {"shares": (2 * shares, shares)}


def check(mesh: sdm.TriangleMesh, grid: sdm.Grid, values: torch.Tensor) -> None:
    vertices, faces = mesh.numpy()
    centres = grid.points().reshape(-1, 3).numpy()
    some = np.random.default_rng(0).permutation(len(centres))[:150]
    assert_exact(vertices, faces, centres[some], values.reshape(-1)[torch.from_numpy(some)])


def test_codes_hold_the_largest_numbers():
    cells, splits = 1 << CELL_BITS, 1 << SPLIT_BITS
    wanted = [(c, s, n) for n in (1, 2, splits) for s in {0, n - 1} for c in (0, 1, cells - 1)]
    codes = np.array([c | s << CELL_BITS | (n - 1) << CELL_BITS + SPLIT_BITS for c, s, n in wanted])
    assert codes.max() < 1 << 31
    np.testing.assert_array_equal(decoded(codes), wanted)
    # Every cell of the largest pass has a number that fits.
    assert cells >= 8 * cost_model.MOST_REGIONS


@pytest.mark.parametrize("split_length", [20, 300, 10**6])
def test_each_cell_is_scheduled_once(seen, split_length):
    mesh = mesh_of("all alike")
    grid = sdm.Grid([-0.3] * 3, [0.03] * 3, [16, 16, 32])
    values = values_of(mesh, grid, split_length=split_length)
    codes, lengths = seen.codes(), seen.lengths[0].sum(1)
    assert not len(seen.coarse[0])
    assert np.unique(codes[:, 0]).tolist() == list(range(8 * seen.count))
    for number in range(8 * seen.count):
        mine = codes[codes[:, 0] == number]
        assert sorted(mine[:, 1]) == list(range(len(mine)))
        assert (mine[:, 2] == len(mine)).all()
        assert len(mine) == min(-(-lengths[number] // split_length), 1 << SPLIT_BITS)
    assert (split_length == 10**6) == (len(codes) == 8 * seen.count)
    check(mesh, grid, values)


@pytest.mark.parametrize("name", NAMES)
def test_coarse_cells_are_measured_by_bricks(seen, name):
    mesh = mesh_of(name)
    for resolution in (26, 72):
        seen.clear()
        grid = sdm.Grid.around(mesh, resolution=resolution)
        values = values_of(mesh, grid)
        # Cells that the grid's end cuts are not as coarse as others.
        assert (len(seen.coarse[0]) > len(seen.whole[0])) == (resolution == 26)
        check(mesh, grid, values)


@pytest.mark.parametrize("shares", [1, 4])
@pytest.mark.parametrize("name", [*NAMES, "all alike"])
def test_large_cells_are_measured_by_bricks_from_one_list(seen, name, shares):
    """Cells of 16^3 voxels, coarse ones too, in splits and shared, of grids that end anywhere in them."""
    mesh = mesh_of(name)
    fine = mesh.numpy()[0].min(0), float(np.ptp(mesh.numpy()[0], 0).max())
    grids = [grid_of(name, mesh), sdm.Grid(fine[0] + 0.3 * fine[1], [fine[1] / 200] * 3, [37, 30, 41])]
    for grid in grids:
        for split_length in (10**6, 13):
            seen.clear()
            values = values_of(mesh, grid, cell=16, split_length=split_length, **shared(shares))
            assert len(seen.codes()) > 0
            check(mesh, grid, values)
    # Of the finer grid no cell is coarse.
    assert len(seen.coarse[0]) == 0


@pytest.mark.parametrize("name", [*NAMES, "all alike"])
def test_slices_change_no_bit(seen, name):
    mesh = mesh_of(name)
    grid = grid_of(name, mesh)
    plain = values_of(mesh, grid, split_length=10**6)
    check(mesh, grid, plain)
    assert (seen.codes()[:, 2] == 1).all()
    for split_length in (1, 7, 100):
        seen.clear()
        values = values_of(mesh, grid, split_length=split_length)
        most = int(seen.codes()[:, 2].max())
        assert most > (1 if split_length < 100 or name == "all alike" else 0)
        assert torch.equal(values.view(torch.int32), plain.view(torch.int32))


@pytest.mark.parametrize("name", [*NAMES, "all alike"])
def test_groups_of_a_block_change_no_bit(seen, name):
    """Several groups make its list, and measure it: cells of both sizes, in splits too, and coarse bricks."""
    mesh = mesh_of(name)
    for grid in (grid_of(name, mesh), sdm.Grid.around(mesh, resolution=14)):
        for cell, split_length in ((8, 10**6), (8, 7), (16, 13)):
            plain = values_of(mesh, grid, cell=cell, split_length=split_length)
            for shares, parts in ((1, 2), (1, 8), (4, 1), (3, 4)):
                sizes = {"block_shares": shares, "block_parts": parts}
                assert_same_bits(values_of(mesh, grid, cell=cell, split_length=split_length, **sizes), plain, sizes)


@pytest.mark.parametrize("name", NAMES)
def test_slices_change_no_bit_beside_bricks_that_are_too_coarse(seen, name):
    """The grid's end cuts cells so that some of their bricks are narrow enough to be measured, and others are not."""
    mesh = mesh_of(name)
    grid = sdm.Grid.around(mesh, resolution=14)
    plain = values_of(mesh, grid, split_length=10**6)
    for split_length in (1, 7):
        seen.clear()
        values = values_of(mesh, grid, split_length=split_length)
        assert max(int(codes[:, 2].max(initial=0)) for codes in seen.coarse) > 1
        assert_same_bits(values, plain, split_length)
    assert seen.split_without_room == 0


@pytest.mark.parametrize("shares", [2, 16])
@pytest.mark.parametrize("name", [*NAMES, "all alike"])
def test_lists_made_by_several_groups(seen, name, shares):
    mesh = mesh_of(name)
    grid = grid_of(name, mesh)
    alone = values_of(mesh, grid)
    alone_lengths = np.concatenate([lengths.sum(1) for lengths in seen.lengths])
    seen.lengths.clear()
    maps = [values_of(mesh, grid, **shared(shares))]
    lengths = np.concatenate(seen.lengths)
    assert lengths.shape[1] == shares
    assert ((lengths > 0).sum(1) > 1).any()
    # What one group does not know of the others' it keeps, but not much.
    assert lengths.sum() < 4 * alone_lengths.sum() + 100 * shares
    maps.append(values_of(mesh, grid, split_length=13, **shared(shares)))
    centres = grid.points().reshape(-1, 3).numpy()
    limit = torch.from_numpy(8 * ROUNDING * scale_of(*mesh.numpy(), centres)).reshape(grid.shape)
    for values in maps:
        check(mesh, grid, values)
        assert ((values.abs() - alone.abs()).abs() <= limit).all()
        assert torch.equal(values < 0, alone < 0)


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("name", [*NAMES, "all alike"])
def test_lists_of_larger_leaves(seen, name, levels):
    mesh = mesh_of(name)
    grid = grid_of(name, mesh)
    plain = values_of(mesh, grid, levels_left_out=0)
    plain_entries = sum(lengths.sum() for lengths in seen.lengths)
    centres = grid.points().reshape(-1, 3).numpy()
    limit = torch.from_numpy(8 * ROUNDING * scale_of(*mesh.numpy(), centres)).reshape(grid.shape)
    for split_length, shares in ((10**6, 1), (13, 4)):
        seen.clear()
        options = {"levels_left_out": levels, "split_length": split_length, **shared(shares)}
        values = values_of(mesh, grid, **options)
        if shares == 1:
            # Not of half or a quarter of the length: a larger leaf is nearer.
            assert sum(lengths.sum() for lengths in seen.lengths) < 0.9 * plain_entries
        check(mesh, grid, values)
        assert ((values.abs() - plain.abs()).abs() <= limit).all()
        assert torch.equal(values < 0, plain < 0)
    # Each mesh of a batch has its own part of the hierarchy.
    turned = torch.stack([mesh.vertices, mesh.vertices[:, [1, 2, 0]], mesh.vertices[:, [2, 0, 1]]])
    with plan_override(**options):
        batch = sdm.signed_distance_maps(turned, mesh.faces, grid)
    for number, vertices in enumerate(turned):
        check(sdm.TriangleMesh(vertices, mesh.faces), grid, batch[number])


@pytest.mark.parametrize("shares", [1, 4])
@pytest.mark.parametrize("room", [1 << 11, 1 << 13, 1 << 14, 1 << 15, 3 << 14])
def test_a_pool_that_runs_out(seen, room, shares):
    """Whose list finds no room is searched voxel by voxel: never wrong, whoever else shares its list or its splits."""
    mesh = mesh_of("overlapping shells")
    grid = sdm.Grid.around(mesh, resolution=40)
    plenty = values_of(mesh, grid)
    assert seen.without_room == 0
    scarce = values_of(mesh, grid, pool_entries=room, split_length=13, **shared(shares))
    assert seen.without_room > 0 or seen.split_without_room > 0
    check(mesh, grid, scarce)
    assert (plenty.abs() - scarce.abs()).abs().max() <= 4 * ROUNDING * 2
    assert torch.equal(plenty < 0, scarce < 0)


@pytest.mark.parametrize("name", ["overlapping shells", "all alike"])
@pytest.mark.parametrize("split_length", [1, 4, 13])
def test_splits_that_find_no_room(seen, name, split_length):
    """The least of some splits may not be the least of all: pools of every size, so that any of them is the last."""
    mesh = mesh_of(name)
    grid = grid_of(name, mesh)
    plenty = values_of(mesh, grid)
    limit = 8 * ROUNDING * float(np.max(scale_of(*mesh.numpy(), grid.points().reshape(-1, 3).numpy())))
    for step in range(0, 34, 6):
        scarce = values_of(mesh, grid, split_length=split_length, pool_entries=int(2048 * 1.25**step))
        assert (plenty.abs() - scarce.abs()).abs().max() <= limit
        assert torch.equal(plenty < 0, scarce < 0)
    assert seen.split_without_room > 0


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("voxels", [(60, 60, 60), (60, 60, 30), (60, 24, 60)])
def test_the_room_that_is_expected_is_enough(seen, turned, voxels):
    """Also where voxels are long, or the grid is turned, so that the boxes around its cells are wider."""
    case = load_case("torus-20000")
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    shape = np.array(voxels)
    spacing = 2.1 / (shape - 1)
    turn, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    turn = turn if turned else np.eye(3)
    grid = sdm.Grid(-turn @ (spacing * (shape - 1) / 2), spacing, shape, turn)
    centres = grid.points().reshape(-1, 3).numpy()
    some = np.random.default_rng(0).permutation(len(centres))[:40]
    values = values_of(mesh, grid)
    assert_exact(case.vertices, case.faces, centres[some], values.reshape(-1)[torch.from_numpy(some)])
    regions = int(np.prod(-(-shape // 16)))
    expected = cost_model.expected_entries(len(case.faces), voxels, int(BLOCK), 1, 1) * regions
    assert seen.used <= expected * cost_model.uneven_room(spacing, turned)


def test_shrink_keeps_the_sign_and_the_least(monkeypatch):
    monkeypatch.setenv("SDM_NUM_THREADS", "4")
    rng = np.random.default_rng(2)
    count, turns = 24, 40_000
    sizes = (10.0 ** rng.uniform(-40, 38, turns * count)).astype(np.float32)
    sizes[rng.random(len(sizes)) < 1e-3] = np.inf
    before = np.array([np.inf, -np.inf, 3.0, -3.0, 0.0, -0.0, 1e-42, -1e-42] * 3, np.float32)
    # One by one the values become ever smaller, so that everybody meets at each.
    by_turns = sizes.reshape(turns, count)
    by_turns[:, :4] = np.sort(by_turns[:, :4], 0)[::-1]
    least = np.minimum(np.abs(before), by_turns.min(0))
    values = wp.array(before, dtype=wp.float32, device="cpu")
    launch(_shrink, len(sizes), [values, wp.array(by_turns.ravel(), dtype=wp.float32, device="cpu")], "cpu", smallest=1)
    after = values.numpy()
    np.testing.assert_array_equal(np.signbit(after), np.signbit(before))
    np.testing.assert_array_equal(np.abs(after), least)
