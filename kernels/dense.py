"""Signed distances at every voxel of a slab of a grid, for a batch of meshes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.blocks import SCRATCH, Output, measure_blocks
from sdm.kernels.cells import CHUNK, COUNTS, STACK, Lists, list_cells
from sdm.kernels.frames import FRAME_FLOATS, make_frames
from sdm.kernels.grid import Slab
from sdm.kernels.lanes import GPU_LANES
from sdm.kernels.launch import threads
from sdm.kernels.points import Winding
from sdm.kernels.scan import slab_winding
from sdm.kernels.search import search_slab
from sdm.kernels.tree import Tree

# Groups of lanes at work at a time: 16 for each of an H100's multiprocessors.
GPU_WORKERS = 132 * 16
# Entries of the pool of lists: 64 to 256 MiB.
SMALLEST_POOL, LARGEST_POOL = 1 << 24, 1 << 26
MOST_CELLS = 1 << 14
# Fewer cells of 16^3 than this leave a GPU idle: take cells of 8^3 instead.
FEWEST_CELLS = 2048


def query_slab(
    tree: Tree,
    winding: Winding,
    slab: Slab,
    values: wp.array,
    ambiguous: wp.array,
    launch: Any,
    empty: Callable[[int, Any], wp.array],
    method: str = "cells",
) -> None:
    """Signed distances of a slab of voxels for a batch of meshes.

    Args:
        tree: The hierarchy of the batch.
        winding: How winding numbers are found.
        slab: Which voxels.
        values: (meshes, n, ny, nz) float32, filled: negative inside.
        ambiguous: (meshes,) int32: the number of voxels whose winding number is within 0.25 of 0.5 is added.
        launch: `sdm.kernels.launch.launch`.
        empty: Allocates scratch: `empty(length, dtype)`.
        method: `"cells"`, or `"search"` for the plain path.
    """
    slab_winding(tree, winding, slab, values, launch)
    if method == "search":
        search_slab(tree, slab, values, ambiguous, launch)
        return
    meshes, *shape = values.shape
    gpu = values.device.is_cuda
    lanes, workers = (GPU_LANES, GPU_WORKERS) if gpu else (1, 16 * threads())
    frames = empty(tree.face.shape[0] * FRAME_FLOATS, wp.float32)
    make_frames(tree, frames, launch)
    lists = Lists()
    for size in (16, 8):
        lists.size = size
        lists.cells = wp.vec3i(*(-(-n // size) for n in shape))
        total = meshes * lists.cells[0] * lists.cells[1] * lists.cells[2]
        if total >= FEWEST_CELLS:
            break
    room = min(max(SMALLEST_POOL, 32 * tree.count), LARGEST_POOL)
    # Lists were seen to be about 5 * triangles * (cell / grid)^2 long on average; a pass has room for twice that.
    expected = 10 * tree.count * (lists.size / max(shape)) ** 2 + 2 * CHUNK
    share = min(total, MOST_CELLS, max(128, int(room / expected)))
    lists.chunks = room // CHUNK
    lists.heads = empty(share, wp.int32)
    lists.lengths = empty(share, wp.int32)
    lists.pool = empty(lists.chunks * CHUNK, wp.int32)
    lists.counts = empty(COUNTS, wp.int32)
    stacks = empty(workers * STACK, wp.int32)
    scratch = empty(workers * SCRATCH, wp.int32)
    out = Output()
    out.values = values
    out.ambiguous = ambiguous
    for first in range(0, total, share):
        lists.first = first
        lists.count = min(share, total - first)
        lists.counts.zero_()
        list_cells(tree, frames, slab, lists, stacks, workers, lanes, launch)
        measure_blocks(tree, frames, slab, lists, scratch, out, workers, lanes, launch)
