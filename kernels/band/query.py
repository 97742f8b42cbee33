"""Query of a narrow band: signed distances at the voxels of blocks near the surface of one mesh.

The stages of the dense query run over the regions that have such voxels, with the same cells, witnesses, lists and
arithmetic, so that each value has the dense map's bits. Only the first and the last stage are told of blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import warp as wp

from sdm.kernels.band.listed_witnesses import find_listed_witnesses
from sdm.kernels.bvh.tree import Tree, coarser, slots_of
from sdm.kernels.culling.voronoi_features import Features
from sdm.kernels.dense.block.winners import MISSED, BlockOutput, put_in_block
from sdm.kernels.dense.block_schedule import BlockSchedule
from sdm.kernels.dense.cell_cache import CellCache
from sdm.kernels.dense.chunk_pool import CHUNK, CandidateLists, ChunkPool
from sdm.kernels.dense.cost_model import MOST_REGIONS, NO_SPLITS
from sdm.kernels.dense.plan import Plan
from sdm.kernels.dense.query import Surface
from sdm.kernels.dense.region_grid import RegionGrid
from sdm.kernels.dense.stage2_regions import REGION_BLOCKS_PER_SM, list_regions
from sdm.kernels.dense.stage3_cells import CELL_BLOCKS_PER_SM, list_cells
from sdm.kernels.dense.stage4_blocks import SCHEDULE_BLOCKS_PER_SM, schedule_blocks
from sdm.kernels.dense.stage5_select import SELECT_BLOCKS_PER_SM, select_features
from sdm.kernels.dense.stage6_measure import measure_scheduled, scratch_rows
from sdm.kernels.dense.voxel_search import searched_distance
from sdm.kernels.dense.workspace import make_workspace
from sdm.kernels.geometry.block_table import VOXELS, voxel_of
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import Output, Slab, voxel
from sdm.kernels.launch import launch, set_array, threads
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, GPU_LANES, gpu_workers
from sdm.kernels.primitives.shared_stacks import STACK

wp.set_module_options({"enable_backward": False})

# Regions of a pass on a CPU: what is written of them is read again before it has left the caches.
CPU_REGIONS = 1 << 11
# Of a GPU's pool, entries for each triangle and at least.
ENTRIES_OF_TRIANGLE, LEAST_ENTRIES = 32, 1 << 22


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM))
def _measure_band(
    begin: int,
    lanes: int,
    tree: Tree,
    features: Features,
    slab: Slab,
    grid: RegionGrid,
    cache: CellCache,
    schedule: BlockSchedule,
    pool: ChunkPool,
    blocks: CandidateLists,
    scratch: wp.array(dtype=wp.float32),
    stacks: wp.array(dtype=wp.int32),
    out: Output,
    to: BlockOutput,
):
    thread = begin + wp.tid()
    measure_scheduled(
        thread, lanes, tree, features, slab, grid, cache, schedule, pool, blocks, scratch, stacks, out, to
    )


@wp.kernel
def _search_voxels(begin: int, workers: int, everywhere: int, tree: Tree, slab: Slab, out: Output, to: BlockOutput):
    """A search of the tree for each voxel that was missed, or for all."""
    worker = begin + wp.tid()
    if everywhere == 0 and out.missed[0] == 0:
        return
    total = to.values.shape[0]
    number = worker
    step = workers
    last = total
    if everywhere != 0:
        # One run each, as the answer for a voxel is a good guess for the next.
        number = int(wp.int64(total) * wp.int64(worker) / wp.int64(workers))
        last = int(wp.int64(total) * wp.int64(worker + 1) / wp.int64(workers))
        step = 1
    guess = slots_of(tree, 0)
    unclear = int(0)
    while number < last:
        value = to.values[number]
        missed = wp.abs(value) >= MISSED
        if everywhere != 0 or missed:
            v = voxel_of(to.table, number)
            if is_within(slab, v):
                if missed:
                    # As its winding number was.
                    inside = value < 0.0
                    value = wp.where(inside, 1.0, 0.0)
                    if not wp.abs(to.values[number]) > MISSED:
                        value = wp.where(inside, 0.6, 0.4)
                    to.values[number] = value
                distance, found = searched_distance(tree, 0, voxel(slab, v[0], v[1], v[2]), guess)
                guess = found
                unclear = unclear + put_in_block(to, number / VOXELS, number & (VOXELS - 1), distance)
        number = number + step
    if unclear > 0:
        fetch_add(out.ambiguous, 0, unclear)


def query_blocks(
    surface: Surface,
    slab: Slab,
    measured: Slab,
    to: Any,
    regions: wp.array,
    ambiguous: wp.array,
    plan: Plan,
    empty: Callable[[int, Any], wp.array],
) -> None:
    """Fill the values of blocks, where winding numbers are, with signed distances.

    Args:
        surface: The mesh.
        slab: The grid of the blocks.
        measured: The grid that the stages run on: the same, or one with more slices (see `BlockOutput.shifts`).
        to: A `BlockOutput`.
        regions: (R,) vec4i, the measured grid's regions of 2^3 cells that have voxels of blocks, see
            `find_listed_witnesses`.
        ambiguous: (1,) int32, to which the near voxels with an unclear winding number are added.
        plan: Of a dense query of the measured grid.
        empty: Allocates scratch.
    """
    device: Any = to.values.device
    out: Any = Output()
    set_array(out, "values", to.values)
    set_array(out, "ambiguous", ambiguous)
    set_array(out, "address", empty(1, wp.int64))
    set_array(out, "winners", empty(0, wp.int32))
    set_array(out, "searched", empty(0, wp.int32))
    if plan.method == "search":
        set_array(out, "missed", empty(1, wp.int32))
        _search(surface, slab, out, to, everywhere=True)
        return
    _run_stages(
        surface,
        measured,
        out,
        to,
        regions,
        band_plan(plan, regions.size, surface.tree.face.shape[0], device.is_cuda),
        empty,
    )
    _search(surface, slab, out, to, everywhere=False)


def band_plan(plan: Plan, regions: int, triangles: int, gpu: bool) -> Plan:
    """The plan for so many of a dense query's regions: it decides the same about each of them.

    On a GPU the pool is their share of the dense query's, and as much again, as those along the surface are alike in
    few ways with all: or, where triangles are in few of them, room for the lists of these.
    """
    most = min(regions, MOST_REGIONS if gpu else CPU_REGIONS, plan.most)
    passes = -(-regions // most)
    most = -(-regions // passes)
    chunks = plan.chunks
    if gpu:
        share = -(-2 * plan.chunks * most // plan.most)
        chunks = min(chunks, max(share, (ENTRIES_OF_TRIANGLE * triangles + LEAST_ENTRIES) // CHUNK))
    return replace(
        plan,
        regions=(0, 0, 0),
        total=regions,
        passes=passes,
        most=most,
        split_length=NO_SPLITS,
        chunks=chunks,
        blocks=8 * most,
    )


def _search(surface: Surface, slab: Slab, out: Any, to: Any, *, everywhere: bool) -> None:
    device: Any = to.values.device
    workers = gpu_workers(device, BLOCKS_PER_SM) * GPU_LANES if device.is_cuda else 16 * threads()
    workers = max(1, to.values.size // 8) if everywhere else workers
    launch(_search_voxels, workers, [workers, int(everywhere), surface.tree, slab, out, to], device, smallest=1)


def _run_stages(
    surface: Surface,
    slab: Slab,
    out: Any,
    to: Any,
    listed: wp.array,
    plan: Plan,
    empty: Callable[[int, Any], wp.array],
) -> None:
    """The stages of `dense.query.run_stages`, over listed regions; no list is cut into splits."""
    whole, frames, features, cones = surface
    tree = coarser(whole, plan.levels_left_out) if plan.levels_left_out > 0 else whole
    device: Any = to.values.device
    gpu = device.is_cuda
    lanes = GPU_LANES if gpu else 1

    def workers(blocks_per_sm: int) -> int:
        return gpu_workers(device, blocks_per_sm) if gpu else 16 * threads()

    work = make_workspace(plan, empty)
    grid, pool, cache, schedule = work.grid, work.pool, work.cache, work.schedule
    regions, cells, shares, blocks = work.regions, work.cells, work.share_witnesses, work.blocks
    stacks = empty(1 if gpu else workers(1) * STACK, wp.int32)
    scratch = empty(1 if gpu else workers(1) * scratch_rows(False) * 4, wp.float32)
    set_array(out, "missed", work.missed)
    for first in range(plan.passes):
        work.begin_pass(plan, first)
        some = workers(SCHEDULE_BLOCKS_PER_SM)
        find_listed_witnesses(tree, frames, slab, grid, listed, work.counters, cache, some, lanes)
        some = workers(REGION_BLOCKS_PER_SM)
        list_regions(tree, frames, cones, slab, grid, cache, pool, regions, stacks, some, lanes)
        some = workers(CELL_BLOCKS_PER_SM)
        list_cells(tree, frames, cones, slab, grid, cache, pool, regions, cells, shares, some, lanes)
        some, length = workers(SCHEDULE_BLOCKS_PER_SM), plan.split_length
        schedule_blocks(tree, frames, features, slab, grid, pool, cells, shares, cache, schedule, length, some, lanes)
        some = workers(SELECT_BLOCKS_PER_SM)
        select_features(
            tree, frames, features, cones, slab, grid, pool, cells, cache, schedule, blocks, stacks, some, lanes
        )
        inputs = [lanes, tree, features, slab, grid, cache, schedule, pool, blocks, scratch, stacks, out, to]
        launch(_measure_band, workers(BLOCKS_PER_SM) * lanes, inputs, device, smallest=1)
