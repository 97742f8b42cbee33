"""Signed distances at every voxel of a slab of a grid, for a batch of meshes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, TypeAlias

import warp as wp

from sdm.kernels.bvh.tree import Tree, coarser
from sdm.kernels.culling.normal_cones import Cones
from sdm.kernels.culling.voronoi_features import Features
from sdm.kernels.dense.block.shared_layout import ROWS
from sdm.kernels.dense.cell_cache import PLACE_FLOATS
from sdm.kernels.dense.plan import Plan
from sdm.kernels.dense.stage1_witnesses import find_witnesses
from sdm.kernels.dense.stage2_regions import REGION_BLOCKS, list_regions
from sdm.kernels.dense.stage3_cells import CELL_BLOCKS, list_cells
from sdm.kernels.dense.stage4_blocks import SCHEDULE_BLOCKS, schedule_blocks
from sdm.kernels.dense.stage5_select import SELECT_BLOCKS, select_features
from sdm.kernels.dense.stage6_measure import measure_blocks
from sdm.kernels.dense.stage7_merge import SLICED_BLOCKS, begin_sliced, end_sliced
from sdm.kernels.dense.voxel_search import mend_slab, search_slab
from sdm.kernels.dense.workspace import BLOCK, CHUNK, COUNTS, LENGTHS, Lists
from sdm.kernels.geometry.voxel_grid import Output, Slab
from sdm.kernels.launch import threads
from sdm.kernels.primitives.lanes import GPU_BLOCKS, GPU_LANES, gpu_workers
from sdm.kernels.primitives.shared_stacks import stack_room
from sdm.kernels.winding.column_sums import slab_winding
from sdm.kernels.winding.winding_number import Winding

# Gives a context whose result makes what comes after it wait for what was launched in it.
Beside: TypeAlias = Callable[[], AbstractContextManager[Callable[[], None]]]


def query_slab(
    tree: Tree,
    frames: wp.array,
    features: Features,
    cones: Cones,
    winding: Winding | None,
    slab: Slab,
    values: wp.array,
    ambiguous: wp.array,
    address: wp.array | None,
    empty: Callable[[int, Any], wp.array],
    beside: Beside,
    plan: Plan,
) -> None:
    """Signed distances of a slab of voxels for a batch of meshes.

    Args:
        tree: The hierarchy of the batch.
        frames: Its triangles' frames.
        features: Their features and neighbours.
        cones: Their cones of normals, and those of the hierarchy's nodes.
        winding: How winding numbers are found; None for distances without a sign.
        slab: Which voxels.
        values: (meshes, n, ny, nz) float32, filled: negative inside.
        ambiguous: (meshes,) int32: the number of voxels whose winding number is within 0.25 of 0.5 is added.
        address: (1,) int64: where the distances go, if not to `values`, which then is scratch; known only when kernels
            run.
        empty: Allocates scratch: `empty(length, dtype)`.
        beside: What is launched in `with beside() as join:` may run beside what comes after it, until `join()`.
        plan: Decisions about the query; distances are exact whatever they are.
    """
    with beside() as join:
        if winding is None:
            values.zero_()
        else:
            # This is bound by memory, and making lists is not.
            slab_winding(tree, winding, slab, values, empty, plan.most_columns)
    gpu = values.device.is_cuda
    out = Output()
    out.values = values.flatten()
    out.ambiguous = ambiguous
    out.missed = empty(1, wp.int32)
    out.elsewhere = 0 if address is None else 1
    out.address = empty(1, wp.int64) if address is None else address
    if plan.method == "search":
        join()
        search_slab(tree, slab, out, values.shape[0])
        return
    lanes = GPU_LANES if gpu else 1

    def workers(blocks: int) -> int:
        return gpu_workers(values.device, blocks) if gpu else 16 * threads()

    lists = Lists()
    lists.cell = plan.cell
    lists.regions = wp.vec3i(*plan.regions)
    whole = tree
    if plan.levels_left_out > 0:
        tree = coarser(whole, plan.levels_left_out)
    lists.region_shares, lists.shares = plan.region_shares, plan.cell_shares
    most = plan.most
    lists.chunks = plan.chunks
    lists.region_heads = empty(most * lists.region_shares, wp.int32)
    lists.region_lengths = empty(most * lists.region_shares, wp.int32)
    lists.heads = empty(8 * most * lists.shares, wp.int32)
    lists.lengths = empty(8 * most * lists.shares, wp.int32)
    lists.witnesses = empty((1 + 8 + 64) * most * 4, wp.float32)
    # Bricks of smaller cells are few, and not noted.
    noted = 8 * most * (9 if plan.cell > BLOCK else 1)
    lists.places = empty(noted * PLACE_FLOATS, wp.float32)
    lists.nearest = empty(8 * most * lists.shares * 4, wp.float32)
    slices = plan.blocks
    lists.slices = slices
    lists.whole = empty(LENGTHS * slices, wp.int32)
    lists.coarse = empty(slices, wp.int32)
    lists.sliced = empty(8 * most, wp.int32)
    lists.lacking = empty(8 * most, wp.int32)
    lists.feature_heads = empty(9 * slices, wp.int32)
    lists.feature_lengths = empty(9 * slices, wp.int32)
    lists.pool = empty(lists.chunks * CHUNK, wp.int32)
    lists.counts = empty(COUNTS, wp.int32)
    stacks = empty(stack_room(workers(max(REGION_BLOCKS, SELECT_BLOCKS, GPU_BLOCKS)), gpu), wp.int32)
    rows = empty(1 if gpu else workers(GPU_BLOCKS) * ROWS * 4, wp.float32)
    sliced = workers(SLICED_BLOCKS) * lanes
    out.missed.zero_()
    # Each pass takes regions from everywhere, so that no pass gets all the long lists.
    lists.step = plan.passes
    for first in range(plan.passes):
        lists.first = first
        lists.count = -(-(plan.total - first) // plan.passes)
        lists.given = lists.count * (lists.region_shares + 8 * lists.shares)
        lists.counts.zero_()
        find_witnesses(tree, frames, slab, lists, workers(SCHEDULE_BLOCKS), lanes)
        list_regions(tree, frames, cones, slab, lists, stacks, workers(REGION_BLOCKS), lanes)
        list_cells(tree, frames, cones, slab, lists, workers(CELL_BLOCKS), lanes)
        schedule_blocks(tree, frames, features, slab, lists, plan.slice_length, workers(SCHEDULE_BLOCKS), lanes)
        with beside() as join_sliced:
            # After the winding numbers, which are made there too.
            begin_sliced(slab, lists, out, sliced)
        select_features(tree, frames, features, cones, slab, lists, stacks, workers(SELECT_BLOCKS), lanes)
        if first == 0:
            # From here on winding numbers are looked at.
            join()
        join_sliced()
        measure_blocks(tree, features, slab, lists, rows, stacks, out, workers(GPU_BLOCKS), lanes)
        end_sliced(slab, lists, out, sliced)
    mend_slab(whole, slab, out, workers(GPU_BLOCKS) * lanes)
