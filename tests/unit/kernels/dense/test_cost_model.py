"""The choice of method for a map: a question of speed, which must not depend on how a grid is cut into slabs."""

from __future__ import annotations

import pytest

from sdm.kernels.bvh.tree import LARGEST_LEAF, depth_for
from sdm.kernels.dense.cost_model import (
    BUSY,
    FEW_CELLS,
    LARGEST_POOL,
    LONG_SPLIT,
    SHORT_SPLIT,
    SMALLEST_POOL,
    cell_for,
    expected_entries,
    has_brick_lists,
    is_measured_together,
    levels_left_out,
    passes_for,
    pool_for,
    search_is_faster,
    shares_and_parts,
    shares_of,
    split_length_for,
)
from sdm.kernels.winding.column_sums import lanes_for_each


def test_coarse_grids_are_searched_and_fine_ones_are_not():
    for gpu in (False, True):
        assert search_is_faster(1_000_000, [32, 32, 32], gpu)
        assert not search_is_faster(100_000, [64, 64, 64], gpu)
        assert not search_is_faster(1_000_000, [128, 128, 128], gpu)


@pytest.mark.parametrize("triangles", [100, 20_000, 1_000_000])
def test_every_slab_of_a_grid_is_treated_alike(triangles):
    slabs = [[layers, 90, 110] for layers in (8, 40, 300)]
    assert len({search_is_faster(triangles, slab, gpu=True) for slab in slabs}) == 1
    assert len({cell_for(triangles, slab, gpu=True) for slab in slabs}) == 1
    assert len({shares_of(triangles, slab, 8) for slab in slabs}) == 1


def test_cells_are_large_where_a_mesh_is_coarse_for_its_grid():
    assert cell_for(20_000, [512] * 3, gpu=True) == cell_for(2_000, [256] * 3, gpu=True) == 16
    assert cell_for(20_000, [200] * 3, gpu=True) == cell_for(100_000, [256] * 3, gpu=True) == 8
    # Where there are many of them their lists may be long.
    assert cell_for(20_000, [256] * 3, gpu=True) == cell_for(1_000_000, [512] * 3, gpu=True) == 16
    assert cell_for(2_000_000, [512] * 3, gpu=True) == 8
    assert cell_for(20_000, [512] * 3, gpu=False) == 8


def test_bricks_have_lists_of_their_own_where_those_of_cells_are_long():
    assert has_brick_lists(20_000, [512] * 3, 16, gpu=True)
    assert has_brick_lists(20_000, [256] * 3, 16, gpu=True)
    assert not has_brick_lists(1_000, [256] * 3, 16, gpu=True)
    assert not has_brick_lists(4_000, [128] * 3, 16, gpu=True)
    assert not has_brick_lists(100_000, [256] * 3, 8, gpu=True)
    assert not has_brick_lists(20_000, [512] * 3, 16, gpu=False)


def test_lists_are_shared_where_they_are_few_or_long():
    for of in (0, 1):
        more, many = (shares_of(20_000, [n] * 3, 8)[of] for n in (128, 512))
        assert more > many == 1
        assert shares_of(1_000_000, [256] * 3, 8)[of] > 1
        # Small maps come in batches.
        assert 1 < shares_of(20_000, [64] * 3, 8)[of] < more


def test_few_blocks_with_short_lists_have_several_groups_each():
    small, large = [64] * 3, [256] * 3
    assert shares_and_parts(1_000, small, 64, 8) == shares_and_parts(4_863, small, 64, 8) == (4, 4)
    assert shares_and_parts(20_480, small, 64, 8) == (2, 2)
    assert shares_and_parts(50_000, small, 64, 8) == shares_and_parts(1_000, large, 4096, 8) == (1, 1)
    # Bricks of larger cells are measured by themselves.
    assert shares_and_parts(1_000, [128] * 3, 64, 16) == (4, 1)
    for regions in (1, 30, 64, 100, 500):
        groups, _ = shares_and_parts(1_000, small, regions, 8)
        assert groups == 1 or 8 * regions * groups <= BUSY


def test_few_blocks_are_measured_by_all_groups_of_a_thread_block():
    # 512 cells of 32^3 or 64^3 voxels, but not those of a batch; nor the bricks of 512 large ones.
    assert is_measured_together(64, 4)
    assert is_measured_together(64, 8)
    assert not is_measured_together(16 * 64, 4)
    assert not is_measured_together(64, 16)


@pytest.mark.parametrize("n", [16, 64, 200, 512, 1024])
@pytest.mark.parametrize("triangles", [12, 20_000, 1_000_000, 10_000_000])
def test_a_cell_shares_out_the_chains_of_its_region(triangles, n):
    of_region, of_cell = shares_of(triangles, [n] * 3, cell_for(triangles, [n] * 3, gpu=True))
    assert of_region % of_cell == 0
    assert of_region & (of_region - 1) == of_cell & (of_cell - 1) == 0


def test_lanes_that_mark_columns():
    columns = 512**2
    for_triangles = [lanes_for_each(n, 1, columns, 1, 32) for n in (12, 20_000, 500_000, 5_000_000)]
    assert for_triangles == [32, 32, 4, 1]
    # The caps of a few large holes get thousands; those of as many meshes as there can be, as many as can be counted.
    assert [lanes_for_each(n, 1, columns, 32, 2048) for n in (4, 1_000, 50_000)] == [2048, 2048, 32]
    assert lanes_for_each(8_000, 60, 1 << 24, 32, 2048) * 8_000 * 60 < 1 << 31


def test_splits_of_few_cells_have_about_as_many_triangles_whatever_the_leaves_hold():
    for triangles in (300, 1_000, 20_088, 69_451, 99_938, 1_000_000, 5_000_000):
        depth = depth_for(triangles)
        leaves = split_length_for(triangles, depth, FEW_CELLS)
        assert leaves in (64, 128)
        assert SHORT_SPLIT / 1.42 < leaves * triangles / 2**depth < SHORT_SPLIT * 1.42
        assert split_length_for(triangles, depth, FEW_CELLS + 1) == LONG_SPLIT
    assert split_length_for(1, 0, 1) >= 32


def test_long_lists_are_made_of_larger_leaves():
    def left_out(triangles, n):
        return levels_left_out(triangles, depth_for(triangles), [n, n, n])

    assert [left_out(1_000_000, n) for n in (64, 128, 256, 512)] == [1, 1, 1, 0]
    assert [left_out(99_938, n) for n in (128, 256, 512)] == [1, 0, 0]
    # These have 4.9 and 4.2 in a leaf, and would have more than eight.
    assert [left_out(triangles, 64) for triangles in (20_088, 69_451)] == [0, 0]
    for triangles in (1, 5, 300, 2_999_824):
        depth = depth_for(triangles)
        for n in (1, 8, 64):
            levels = levels_left_out(triangles, depth, [n, n, n])
            assert 0 <= levels <= depth
            assert levels == 0 or triangles / 2 ** (depth - levels) <= LARGEST_LEAF


@pytest.mark.parametrize("n", [64, 128, 256, 512, 1024])
@pytest.mark.parametrize("triangles", [12, 20_000, 100_000, 1_000_000, 5_000_000])
@pytest.mark.parametrize("gib", [8, 80])
def test_as_few_passes_as_there_is_room_for(triangles, n, gib):
    shape, cell = [n] * 3, cell_for(triangles, [n] * 3, gpu=True)
    regions = (n // (2 * cell)) ** 3
    expected = expected_entries(triangles, shape, cell, *shares_of(triangles, shape, cell))
    room = pool_for(expected, regions, gib << 30)
    passes = passes_for(expected, regions, room)
    assert SMALLEST_POOL <= room <= LARGEST_POOL
    assert 4 * room <= max(gib << 26, 4 * SMALLEST_POOL)
    each = -(-regions // passes)
    assert each <= 16 or expected * each <= room + expected
    if regions <= 1 << 15 and expected * regions <= SMALLEST_POOL:
        assert passes == 1


def test_ordinary_maps_take_one_pass():
    for triangles, n in (
        (20_000, 64),
        (100_000, 256),
        (100_000, 512),
        (1_000_000, 256),
        (1_000_000, 512),
        (5_000_000, 256),
    ):
        shape, cell = [n] * 3, cell_for(triangles, [n] * 3, gpu=True)
        regions = (n // (2 * cell)) ** 3
        expected = expected_entries(triangles, shape, cell, *shares_of(triangles, shape, cell))
        assert passes_for(expected, regions, pool_for(expected, regions, 80 << 30)) == 1
