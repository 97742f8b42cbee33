"""Signed distances at every voxel of a slab of a grid, for a batch of meshes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any, TypeAlias

import warp as wp

from sdm.kernels.blocks import measure_blocks
from sdm.kernels.cells import CELL_BLOCKS, list_cells
from sdm.kernels.cones import Cones
from sdm.kernels.grid import Output, Slab
from sdm.kernels.lanes import GPU_BLOCKS, GPU_LANES, gpu_workers
from sdm.kernels.launch import threads
from sdm.kernels.least import VOXELS
from sdm.kernels.lists import CELL, CHUNK, COUNTS, LENGTHS, REGION, Lists
from sdm.kernels.parts import Parts
from sdm.kernels.plan import CELL_BITS, PLAN_BLOCKS, plan_blocks
from sdm.kernels.regions import REGION_BLOCKS, list_regions
from sdm.kernels.rows import ROWS
from sdm.kernels.scan import slab_winding
from sdm.kernels.search import mend_slab, search_slab
from sdm.kernels.selection import select_parts
from sdm.kernels.stacks import stack_room
from sdm.kernels.tree import Tree
from sdm.kernels.voxels import Features
from sdm.kernels.winding import Winding
from sdm.kernels.witness import find_witnesses

# Gives a context whose result makes what comes after it wait for what was launched in it.
Beside: TypeAlias = Callable[[], AbstractContextManager[Callable[[], None]]]
# Entries of the pool of lists: 64 MiB on a CPU, 128 MiB to 4 GiB on a GPU, of which they take at most a 16th.
CPU_POOL, SMALLEST_POOL, LARGEST_POOL = 1 << 24, 1 << 25, 1 << 30
POOL_SHARE = 16
# More than is expected, as cells whose lists find no room are searched voxel by voxel, which takes many times as long.
POOL_ROOM = 1.6
MOST_REGIONS = 1 << (CELL_BITS - 3)
# Groups of lanes of one map that are enough to keep a GPU busy, and up to how many share the list of a region, and of a
# cell, for that: of a batch's maps they are as many as of one alone, where fewer, longer chains would be faster.
FULL, MOST_FOR_REGION, MOST_FOR_CELL = 1 << 14, 32, 8
# Triangles of a cell's list, on average, up to which all lists are about as short.
SHORT = 64
# Triangles of a list, on average, that one group may make without holding up the others, and up to how many groups
# share the list of a region, and of a cell, for that.
LONG_SHARE = 256
MOST_OF_REGION, MOST_OF_CELL = 64, 16
# Leaves of a cell's list that one group of lanes takes: of up to this many cells, and of more. A CPU has fewer groups.
FEW_CELLS = 1 << 13
SLICE = {"cuda": (128, 256), "cpu": (LARGEST_POOL, LARGEST_POOL)}
# Longer lists than this, on average, cost more than one search a voxel (measured, see bench/NOTES.md).
LONGEST_LIST = {"cuda": 50_000, "cpu": 16_000}


def expected_list(triangles: int, shape: Sequence[int]) -> float:
    """Triangles in the list of a cell, on average: a fit to bunny, rocker-arm, nefertiti and tori.

    From the slab's cross-section alone, so that every slab of a grid is treated in the same way.
    """
    return 1.4 * triangles * int(CELL) ** 2 / max(shape[1:]) ** 2


def expected_entries(triangles: int, shape: Sequence[int], of_region: int, of_cell: int) -> float:
    """Entries of the pool that a region and its cells take, on average: a fit to the same meshes.

    Of a region's leaves, and of its cells' leaves and parts; half a chunk more for each chain of the first two, whose
    last one is not full, and of the parts.
    """
    length = expected_list(triangles, shape)
    leaves, parts = 0.8 * length + 25.0, 2.0 * length + 10.0
    half = CHUNK / 2
    return 4.5 * leaves + of_region * half + 8.0 * (leaves + of_cell * half + parts + half)


def search_is_faster(triangles: int, shape: Sequence[int], gpu: bool) -> bool:
    """Whether the plain path is expected to be the faster one; the same for any batch, so that its maps are too."""
    return expected_list(triangles, shape) > LONGEST_LIST["cuda" if gpu else "cpu"]


def shares_of(triangles: int, shape: Sequence[int]) -> tuple[int, int]:
    """Groups of lanes that make each list of a region, and of a cell, on a GPU: so many that none is waited for.

    From the slab's cross-section alone, as `expected_list`. Powers of two: a level of the tree is shared out. A cell's
    are no more than its region's, whose chains they share out.
    """
    regions = max(1, -(-max(shape[1:]) // int(REGION))) ** 3
    length = expected_list(triangles, shape)
    of_region = of_cell = 1
    while (of_region < MOST_FOR_REGION and 2 * of_region * regions <= FULL) or (
        of_region < MOST_OF_REGION and of_region * LONG_SHARE < 2.0 * length
    ):
        of_region *= 2
    # Lists of very different lengths need more groups than those that are all short.
    enough = FULL if length < SHORT else 8 * FULL
    while (of_cell < MOST_FOR_CELL and 2 * of_cell * 8 * regions <= enough) or (
        of_cell < MOST_OF_CELL and of_cell * LONG_SHARE < length
    ):
        of_cell *= 2
    return of_region, min(of_cell, of_region)


def largest_pool(device: Any) -> int:
    """Entries of the largest pool of lists on this device."""
    return min(LARGEST_POOL, max(SMALLEST_POOL, int(device.total_memory) // POOL_SHARE // 4))


def query_slab(
    tree: Tree,
    frames: wp.array,
    parts: Parts,
    cones: Cones,
    winding: Winding,
    slab: Slab,
    values: wp.array,
    ambiguous: wp.array,
    launch: Any,
    empty: Callable[[int, Any], wp.array],
    beside: Beside,
    method: str = "auto",
) -> None:
    """Signed distances of a slab of voxels for a batch of meshes.

    Args:
        tree: The hierarchy of the batch.
        frames: Its triangles' frames.
        parts: Their parts and neighbours.
        cones: Their cones of normals, and those of the hierarchy's nodes.
        winding: How winding numbers are found.
        slab: Which voxels.
        values: (meshes, n, ny, nz) float32, filled: negative inside.
        ambiguous: (meshes,) int32: the number of voxels whose winding number is within 0.25 of 0.5 is added.
        launch: `sdm.kernels.launch.launch`.
        empty: Allocates scratch: `empty(length, dtype)`.
        beside: What is launched in `with beside() as join:` may run beside what comes after it, until `join()`.
        method: `"cells"` for the fast path, `"search"` for the plain one, `"auto"` for the one that is expected to be
            faster. Both are exact.
    """
    with beside() as join:
        # This is bound by memory, and making lists is not.
        slab_winding(tree, winding, slab, values, launch, empty)
    meshes, *shape = values.shape
    gpu = values.device.is_cuda
    if method == "auto":
        method = "search" if search_is_faster(tree.count, shape, gpu) else "cells"
    out = Output()
    out.values = values.flatten()
    out.ambiguous = ambiguous
    out.missed = empty(1, wp.int32)
    if method == "search":
        join()
        search_slab(tree, slab, out, meshes, launch)
        return
    lanes = GPU_LANES if gpu else 1

    def workers(blocks: int) -> int:
        return gpu_workers(blocks) if gpu else 16 * threads()

    lists = Lists()
    lists.regions = wp.vec3i(*(-(-n // int(REGION)) for n in shape))
    total = meshes * lists.regions[0] * lists.regions[1] * lists.regions[2]
    slice_length = SLICE["cuda" if gpu else "cpu"][int(8 * total > FEW_CELLS)]
    lists.region_shares, lists.shares = shares_of(tree.count, shape) if gpu else (1, 1)
    expected = POOL_ROOM * expected_entries(tree.count, shape, lists.region_shares, lists.shares)
    # A large pool takes memory, several passes take time, as each waits for its longest lists.
    wanted = max(SMALLEST_POOL, math.ceil(expected * total))
    room = min(wanted, largest_pool(values.device)) if gpu else CPU_POOL
    fit = total if wanted <= room else max(16, int(room / expected))
    passes = -(-total // min(total, MOST_REGIONS, fit))
    most = -(-total // passes)
    lists.chunks = room // CHUNK
    lists.region_heads = empty(most * lists.region_shares, wp.int32)
    lists.region_lengths = empty(most * lists.region_shares, wp.int32)
    lists.heads = empty(8 * most * lists.shares, wp.int32)
    lists.lengths = empty(8 * most * lists.shares, wp.int32)
    lists.witnesses = empty((1 + 8 + 64) * most * 4, wp.float32)
    lists.nearest = empty(8 * most * lists.shares * 4, wp.float32)
    # Each slice but the last of a list is full.
    slices = 8 * most + lists.chunks * CHUNK // slice_length
    lists.slices = slices
    lists.whole = empty(LENGTHS * slices, wp.int32)
    lists.coarse = empty(slices, wp.int32)
    lists.sliced = empty(8 * most, wp.int32)
    lists.part_heads = empty(9 * slices, wp.int32)
    lists.part_lengths = empty(9 * slices, wp.int32)
    lists.pool = empty(lists.chunks * CHUNK, wp.int32)
    lists.counts = empty(COUNTS, wp.int32)
    stacks = empty(stack_room(workers(max(REGION_BLOCKS, GPU_BLOCKS)), gpu), wp.int32)
    features = Features()
    features.rows = empty(1 if gpu else workers(GPU_BLOCKS) * ROWS * 4, wp.float32)
    features.points = empty(1 if gpu else workers(GPU_BLOCKS) * 3 * VOXELS, wp.float32)
    features.least = empty(workers(GPU_BLOCKS) * VOXELS, wp.float32)
    out.missed.zero_()
    # Each pass takes regions from everywhere, so that no pass gets all the long lists.
    lists.step = passes
    for first in range(passes):
        lists.first = first
        lists.count = -(-(total - first) // passes)
        lists.given = lists.count * (lists.region_shares + 8 * lists.shares)
        lists.counts.zero_()
        find_witnesses(tree, frames, slab, lists, workers(PLAN_BLOCKS), lanes, launch)
        list_regions(tree, frames, cones, slab, lists, stacks, workers(REGION_BLOCKS), lanes, launch)
        list_cells(tree, frames, cones, slab, lists, workers(CELL_BLOCKS), lanes, launch)
        if first == 0:
            # From here on winding numbers are looked at.
            join()
        plan_blocks(tree, frames, parts, slab, lists, slice_length, out, workers(PLAN_BLOCKS), lanes, launch)
        select_parts(tree, frames, parts, cones, slab, lists, stacks, workers(GPU_BLOCKS), lanes, launch)
        measure_blocks(tree, parts, slab, lists, features, stacks, out, workers(GPU_BLOCKS), lanes, launch)
    mend_slab(tree, slab, out, workers(GPU_BLOCKS) * lanes, launch)
