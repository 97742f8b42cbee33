"""Which way a map is computed: a choice of speed, which must not depend on how a grid is cut into slabs."""

from __future__ import annotations

import pytest

from sdm.kernels.dense import search_is_faster, shares_of


def test_coarse_grids_are_searched_and_fine_ones_are_not():
    for gpu in (False, True):
        assert search_is_faster(1_000_000, [32, 32, 32], gpu)
        assert not search_is_faster(100_000, [64, 64, 64], gpu)
        assert not search_is_faster(1_000_000, [128, 128, 128], gpu)


@pytest.mark.parametrize("triangles", [100, 20_000, 1_000_000])
def test_every_slab_of_a_grid_is_treated_alike(triangles):
    slabs = [[layers, 90, 110] for layers in (8, 40, 300)]
    assert len({search_is_faster(triangles, slab, gpu=True) for slab in slabs}) == 1
    assert len({shares_of(triangles, slab) for slab in slabs}) == 1


def test_lists_are_shared_where_they_are_few_or_long():
    for of in (0, 1):
        few, more, many = (shares_of(20_000, [n] * 3)[of] for n in (64, 128, 512))
        assert few >= more > many == 1
        assert shares_of(1_000_000, [256] * 3)[of] > 1


@pytest.mark.parametrize("n", [16, 64, 200, 512, 1024])
@pytest.mark.parametrize("triangles", [12, 20_000, 1_000_000, 10_000_000])
def test_a_cell_shares_out_the_chains_of_its_region(triangles, n):
    of_region, of_cell = shares_of(triangles, [n] * 3)
    assert of_region % of_cell == 0
    assert of_region & (of_region - 1) == of_cell & (of_cell - 1) == 0
