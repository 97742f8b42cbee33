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


def test_lists_are_shared_where_regions_are_few():
    assert shares_of(20_000, [64] * 3) > shares_of(20_000, [256] * 3) > shares_of(20_000, [512] * 3) == 1
    assert shares_of(1_000_000, [256] * 3) > 1
