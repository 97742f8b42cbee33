"""Signed distances at every voxel of a slab of a grid, for a batch of meshes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import warp as wp

from sdm.kernels.bricks import measure_bricks
from sdm.kernels.cells import CELL, CHUNK, COUNTS, STACK, Lists, list_cells
from sdm.kernels.features import ROWS, Features
from sdm.kernels.grid import Output, Slab
from sdm.kernels.lanes import GPU_LANES
from sdm.kernels.launch import threads
from sdm.kernels.parts import Parts
from sdm.kernels.points import Winding
from sdm.kernels.scan import slab_winding
from sdm.kernels.search import mend_slab, search_slab
from sdm.kernels.tree import Tree

# Groups of lanes at work at a time: 16 for each of an H100's multiprocessors.
GPU_WORKERS = 132 * 16
# Entries of the pool of lists: 64 to 256 MiB.
SMALLEST_POOL, LARGEST_POOL = 1 << 24, 1 << 26
MOST_CELLS = 1 << 17
# Longer lists than this, on average, cost more than one search a voxel (measured, see bench/NOTES.md).
LONGEST_LIST = {"cuda": 3000, "cpu": 600}
# So do shorter ones where there are too few bricks to keep a GPU busy until the longest is done.
FEW_VOXELS = 1 << 19
LONGEST_LIST_OF_FEW = 500


def expected_list(triangles: int, shape: Sequence[int]) -> float:
    """Triangles in the list of a cell, on average: a fit to bunny, rocker-arm, nefertiti and tori.

    From the slab's cross-section alone, so that every slab of a grid is treated in the same way.
    """
    return 1.8 * triangles * int(CELL) ** 2 / max(shape[1:]) ** 2


def search_is_faster(meshes: int, triangles: int, shape: Sequence[int], gpu: bool) -> bool:
    """Whether the plain path is expected to be the faster one."""
    length = expected_list(triangles, shape)
    if gpu and meshes * (shape[1] * shape[2]) ** 1.5 < FEW_VOXELS and length > LONGEST_LIST_OF_FEW:
        return True
    return length > LONGEST_LIST["cuda" if gpu else "cpu"]


def query_slab(
    tree: Tree,
    frames: wp.array,
    parts: Parts,
    winding: Winding,
    slab: Slab,
    values: wp.array,
    ambiguous: wp.array,
    launch: Any,
    empty: Callable[[int, Any], wp.array],
    method: str = "auto",
) -> None:
    """Signed distances of a slab of voxels for a batch of meshes.

    Args:
        tree: The hierarchy of the batch.
        frames: Its triangles' frames.
        parts: Their parts and neighbours.
        winding: How winding numbers are found.
        slab: Which voxels.
        values: (meshes, n, ny, nz) float32, filled: negative inside.
        ambiguous: (meshes,) int32: the number of voxels whose winding number is within 0.25 of 0.5 is added.
        launch: `sdm.kernels.launch.launch`.
        empty: Allocates scratch: `empty(length, dtype)`.
        method: `"cells"` for the fast path, `"search"` for the plain one, `"auto"` for the one that is expected to be
            faster. Both are exact.
    """
    slab_winding(tree, winding, slab, values, launch, empty)
    meshes, *shape = values.shape
    gpu = values.device.is_cuda
    if method == "auto":
        method = "search" if search_is_faster(meshes, tree.count, shape, gpu) else "cells"
    out = Output()
    out.values = values
    out.ambiguous = ambiguous
    out.missed = empty(1, wp.int32)
    if method == "search":
        search_slab(tree, slab, out, launch)
        return
    lanes, workers = (GPU_LANES, GPU_WORKERS) if gpu else (1, 16 * threads())
    lists = Lists()
    lists.cells = wp.vec3i(*(-(-n // int(CELL)) for n in shape))
    total = meshes * lists.cells[0] * lists.cells[1] * lists.cells[2]
    room = min(max(SMALLEST_POOL, 32 * tree.count), LARGEST_POOL)
    # A pass has room for half as much again as is expected.
    expected = 1.5 * expected_list(tree.count, shape) + 2 * CHUNK
    share = min(total, MOST_CELLS, max(128, int(room / expected)))
    lists.chunks = room // CHUNK
    lists.heads = empty(share, wp.int32)
    lists.lengths = empty(share, wp.int32)
    lists.pool = empty(lists.chunks * CHUNK, wp.int32)
    lists.counts = empty(COUNTS, wp.int32)
    stacks = empty(workers * STACK, wp.int32)
    features = Features()
    features.rows = empty(workers * ROWS * 4, wp.float32)
    features.least = empty(workers * 64, wp.float32)
    out.missed.zero_()
    for first in range(0, total, share):
        lists.first = first
        lists.count = min(share, total - first)
        lists.counts.zero_()
        list_cells(tree, frames, parts, slab, lists, stacks, workers, lanes, launch)
        measure_bricks(tree, frames, parts, slab, lists, features, out, workers, lanes, launch)
    mend_slab(tree, slab, out, workers * lanes, launch)
