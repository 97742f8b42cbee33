"""Query of a narrow band: signed distances at the voxels of blocks near the surface of one mesh.

The stages of the dense query run over the regions that have such voxels, with the same cells, witnesses, lists and
arithmetic, so that each value has the dense map's bits. Only the first and the last stage are told of blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import Any

import warp as wp

from sdm.kernels.band.block_bits import AMBIGUOUS, CHUNKS
from sdm.kernels.band.listed_witnesses import find_listed_witnesses
from sdm.kernels.bvh.tree import Tree, slots_of
from sdm.kernels.culling.voronoi_features import Features
from sdm.kernels.dense.block.winners import MISSED, BlockOutput, put_in_block
from sdm.kernels.dense.block_schedule import BlockSchedule
from sdm.kernels.dense.cell_cache import CellCache
from sdm.kernels.dense.chunk_pool import CHUNK, CandidateLists, ChunkPool
from sdm.kernels.dense.cost_model import MOST_REGIONS, NO_SPLITS, blocks_for
from sdm.kernels.dense.counters import NEXT_CHUNK
from sdm.kernels.dense.plan import Plan
from sdm.kernels.dense.query import OwnStages, Surface, run_stages
from sdm.kernels.dense.region_grid import RegionGrid
from sdm.kernels.dense.stage6_measure import measure_blocks, measure_scheduled
from sdm.kernels.dense.voxel_search import searched_distance
from sdm.kernels.dense.workspace import size_for
from sdm.kernels.geometry.block_table import VOXELS, voxel_of
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import Output, Slab, voxel
from sdm.kernels.launch import launch, set_array
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM

wp.set_module_options({"enable_backward": False})

# Regions of a pass on a CPU: what is written of them is read again before it has left the caches.
CPU_REGIONS = 1 << 11
# Of a GPU's pool, entries for each triangle and at least.
ENTRIES_OF_TRIANGLE, LEAST_ENTRIES = 32, 1 << 22
# And of one pass at most so many chunks, a gibibyte: with more there are more passes, which cost some launches each.
MOST_CHUNKS = (1 << 30) // (4 * CHUNK)
LEAST_REGIONS = 1 << 8
# Which argument of `measure_blocks` is the pool.
POOL = 6


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
        thread, lanes, tree, features, slab, grid, cache, schedule, pool, blocks, scratch, stacks, out, 1, 1, to
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


@wp.kernel
def _note_chunks(begin: int, pool: ChunkPool, counts: wp.array(dtype=wp.int32)):
    counts[CHUNKS] = counts[CHUNKS] + pool.reserved + pool.counters[NEXT_CHUNK]


def query_blocks(
    surface: Surface,
    slab: Slab,
    measured: Slab,
    to: Any,
    regions: wp.array,
    counts: wp.array,
    plan: Plan,
    empty: Callable[[int, Any], wp.array],
    chunks: int | None = None,
    join_surface: Callable[[], None] | None = None,
    join_winding: Callable[[], None] | None = None,
) -> None:
    """Fill the values of blocks, where winding numbers are, with signed distances.

    Args:
        surface: The mesh.
        slab: The grid of the blocks.
        measured: The grid that the stages run on: the same, or one with more slices (see `BlockOutput.shifts`).
        to: A `BlockOutput`.
        regions: (R,) vec4i, the measured grid's regions of 2^3 cells that have voxels of blocks, see
            `find_listed_witnesses`.
        counts: See `block_bits`: `REGIONS` is read, with fewer than R the rest is room; to `AMBIGUOUS` the near voxels
            with an unclear winding number are added; `CHUNKS` is what all passes had of the pool, or would have had.
        plan: Of a dense query of the measured grid.
        empty: Allocates workspace.
        chunks: Of the pool on a GPU, if it is known how many are needed. What finds no room there is searched.
        join_surface: Called before features and cones are looked at.
        join_winding: Called before winding numbers are, and before `to` is.
    """
    device: Any = to.values.device
    out: Any = Output()
    set_array(out, "values", to.values)
    set_array(out, "ambiguous", counts[AMBIGUOUS : AMBIGUOUS + 1])
    set_array(out, "address", empty(1, wp.int64))
    set_array(out, "winners", empty(0, wp.int32))
    set_array(out, "searched", empty(0, wp.int32))
    join_both, join = join_surface or _nothing, join_winding or _nothing
    if plan.method == "search":
        join_both()
        join()
        set_array(out, "missed", empty(1, wp.int32))
        _search_blocks(slab, to, surface.tree, measured, out, max(1, to.values.size // 8), everywhere=True)
        return
    plan = band_plan(plan, regions.size, surface.tree.face.shape[0], device.is_cuda, chunks)

    def find(*given: Any) -> None:
        find_listed_witnesses(regions, counts, *given)
        join_both()

    def measure(*given: Any) -> None:
        measure_blocks(*given, kernel=_measure_band, more=[to])
        launch(_note_chunks, 1, [given[POOL], counts], device)

    own = OwnStages(
        find,
        measure,
        partial(_search_blocks, slab, to),
    )
    run_stages(surface, measured, out, plan, empty, partial(nullcontext, _nothing), join, own)


def band_plan(plan: Plan, regions: int, triangles: int, gpu: bool, known: int | None = None) -> Plan:
    """The plan for so many of a dense query's regions: it decides the same about each of them.

    On a GPU the pool is their share of the dense query's, and as much again, as those along the surface are alike in
    few ways with all: or, where triangles are in few of them, room for the lists of these; or as many chunks as are
    `known` to be needed. Of the first two no pass gets more than `MOST_CHUNKS`.
    """
    most = min(regions, MOST_REGIONS if gpu else CPU_REGIONS, plan.most)
    chunks = plan.chunks
    if gpu:
        least = (ENTRIES_OF_TRIANGLE * triangles + LEAST_ENTRIES) // CHUNK
        needed = known or -(-2 * chunks * regions // plan.most)
        most = min(most, max(LEAST_REGIONS, MOST_CHUNKS * regions // needed))
        passes = -(-regions // most)
        # Passes are not quite alike.
        share = needed if passes == 1 else needed * 9 // (8 * passes)
        chunks = min(chunks, share if known else max(share, least))
    passes = -(-regions // most)
    most = -(-regions // passes)
    return replace(
        plan,
        regions=(0, 0, 0),
        total=regions,
        passes=passes,
        most=most,
        split_length=NO_SPLITS,
        list_bricks_below=0,
        # What a pass has of the pool is counted by groups of one a block.
        block_shares=1,
        block_parts=1,
        together=False,
        chunks=chunks,
        blocks=blocks_for(most, 0, NO_SPLITS, plan.by_brick),
    )


def bytes_for(plan: Plan, regions: int, triangles: int, chunks: int) -> int:
    """Bytes of workspace that a GPU's query of so many regions and chunks takes, by the plan of a dense one."""
    return size_for(band_plan(plan, regions, triangles, True, chunks))


def _nothing() -> None:
    """There is nothing to wait for."""


def _search_blocks(
    slab: Slab, to: Any, tree: Tree, _measured: Slab, out: Any, workers: int, *, everywhere: bool = False
) -> None:
    """`dense.voxel_search.mend_slab` of blocks of the grid `slab`, or a search for each of their voxels."""
    inputs = [workers, int(everywhere), tree, slab, out, to]
    launch(_search_voxels, workers, inputs, to.values.device, smallest=1)
