"""Which way a map is computed: a choice of speed, which must not depend on how a grid is cut into slabs."""

from __future__ import annotations

import pytest

from sdm.kernels.dense import search_is_faster


@pytest.mark.parametrize("gpu", [False, True])
def test_coarse_grids_are_searched_and_fine_ones_are_not(gpu):
    assert search_is_faster(1_000_000, [64, 64, 64], gpu)
    assert not search_is_faster(20_000, [256, 256, 256], gpu)


def test_small_grids_of_fine_meshes_leave_a_gpu_idle():
    assert search_is_faster(100_000, [64, 64, 64], True)
    assert not search_is_faster(20_000, [64, 64, 64], True)
    assert not search_is_faster(100_000, [128, 128, 128], True)


@pytest.mark.parametrize("gpu", [False, True])
@pytest.mark.parametrize("triangles", [100, 20_000, 1_000_000])
def test_every_slab_of_a_grid_is_treated_alike(gpu, triangles):
    choices = {search_is_faster(triangles, [layers, 90, 110], gpu) for layers in (8, 40, 300)}
    assert len(choices) == 1
