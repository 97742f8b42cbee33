"""The order of keys, by comparing each with all and by buckets: that of a stable sort."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from sdm.kernels.bvh.rank_sort import COMPARED, LARGEST, RankSort, is_ranked
from sdm.kernels.bvh.tree import COUNT, FIRST, PART_SIZE, Tree

BITS = 24


def _tree(own, total):
    tree = Tree()
    tree.count = own
    if own < total:
        # One mesh, and what fills room behind it.
        parts = np.zeros(2 * PART_SIZE, np.int32)
        parts[COUNT], parts[PART_SIZE + FIRST], parts[PART_SIZE + COUNT] = own, own, 1
        tree.parts = wp.array(parts, dtype=wp.int32, device="cpu")
        tree.meshes = 2
    return tree


def _order(keys, own):
    total = len(keys)
    slots = np.concatenate([np.arange(own), np.arange(total - own)]).astype(np.int32)
    memory = wp.array(np.full(2 * total, -1), dtype=wp.int64, device="cpu")
    numbers = wp.array(np.concatenate([slots, np.full(total, -1, np.int32)]), dtype=wp.int32, device="cpu")
    ranks = RankSort(memory, numbers, BITS)
    ranks.short.numpy()[:] = keys
    if ranks.counts.shape[0]:
        ranks.counts.numpy()[:] = np.bincount(keys[:own] >> (BITS - 10), minlength=ranks.counts.shape[0])
    tree = _tree(own, total)
    return ranks.order(tree).numpy().copy(), slots[np.argsort(keys, kind="stable")]


@pytest.mark.parametrize("total", [1, 2, 100, COMPARED, COMPARED + 1, 9000, LARGEST])
@pytest.mark.parametrize("spread", [1, 50, 1 << BITS])
def test_as_a_stable_sort(total, spread):
    rng = np.random.default_rng(total)
    keys = rng.integers(0, spread, total).astype(np.int32)
    found, expected = _order(keys, total)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("total", [300, 6000])
def test_what_fills_room_stays_behind(total):
    rng = np.random.default_rng(total)
    for own in (1, total // 3, total - 1):
        keys = rng.integers(0, 1 << BITS, total).astype(np.int32)
        # Also some of the mesh's own have the largest key.
        keys[rng.integers(0, own, 3)] = (1 << BITS) - 1
        keys[own:] = (1 << BITS) - 1
        found, expected = _order(keys, own)
        np.testing.assert_array_equal(found, expected)


def test_which_are_sorted_so():
    assert is_ranked(LARGEST, 1, False, BITS)
    assert is_ranked(LARGEST, 2, True, BITS)
    assert not is_ranked(LARGEST, 2, False, BITS + 1)
    assert not is_ranked(LARGEST + 1, 1, False, BITS)
    assert not is_ranked(1000, 1, False, 40)
