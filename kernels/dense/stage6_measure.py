"""Stage 6 of the dense query: the distances themselves, block by block.

One group of lanes takes one block, or a split of its list of features. It works the features out for the block's
centre, one a lane, and finds the octants that each can be nearest to; then one such pair a lane, and finds the eighths
of the octant; then measures one feature in one eighth a lane. In the end all voxels are written.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import BY_FACES, Tree
from sdm.kernels.culling.leaf_filter import push
from sdm.kernels.culling.voronoi_features import Features
from sdm.kernels.dense.block.feature_setup import (
    CORNER_KIND,
    EDGE_KIND,
    FeatureBatch,
    add_corner,
    add_edge,
    add_face,
    kind_of,
    next_batch,
    tests_of,
)
from sdm.kernels.dense.block.octant_tests import eighths_of, octants_in_slab, octants_of
from sdm.kernels.dense.block.octants_on_cpu import by_octants, measure_list
from sdm.kernels.dense.block.shared_layout import BATCH, ITEMS, MOST_ITEMS, PAIRS, SCRATCH_ROWS
from sdm.kernels.dense.block.voxels import NEAR_ENDS, Block, write_coordinates
from sdm.kernels.dense.block.winners import (
    NO_WINNERS,
    WINNER_ROWS,
    begin_block,
    end_block,
    is_wanted,
    measure_one,
    note_feature,
    worker_scratch,
)
from sdm.kernels.dense.block_schedule import BY_GROUPS, BlockSchedule, groups_at_work, whole_blocks
from sdm.kernels.dense.cell_cache import CellCache
from sdm.kernels.dense.chunk_pool import (
    CandidateLists,
    ChunkPool,
    Reader,
    list_length,
    read_entry,
    read_on,
    start_reading,
)
from sdm.kernels.dense.counters import COARSE, NEXT_BLOCK
from sdm.kernels.dense.region_grid import BLOCK, RegionGrid
from sdm.kernels.dense.stage5_select import block_of
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import BY_GRID, Output, Slab, slab_of
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, on_cpu, wait_for_lanes
from sdm.kernels.primitives.shared_stacks import small_stack_of
from sdm.kernels.primitives.work_queues import FEATURE_BITS, PAIR_BITS, enqueue, queue_entry

wp.set_module_options({"enable_backward": False})

# Where a worker's stacks begin: of faces, edges and corners that wait, at most 64 each.
FACES, EDGES, CORNERS = 0, 64, 128


@wp.func
def measure_features(
    scratch: wp.uint64,
    batch: FeatureBatch,
    octants: int,
    room: float,
    near: bool,
    turned: bool,
    winners: Any,
    lane: int,
    lanes: int,
):
    """Measure the lanes' features, whose rows are written, where they matter in the block's `octants` (bits) for each.

    Each step queues work for the next, so that all lanes have some.
    """
    pairs = int(0)
    items = int(0)
    # The next of the pairs; before all of them, the features themselves.
    first = int(-1)
    while first < pairs or items > 0:
        if first < pairs and items + 8 * lanes <= MOST_ITEMS:
            level = wp.where(first < 0, 0, 1)
            tag = int(lane)
            boxes = int(octants)
            if level == 1:
                boxes = int(0)
                if first + lane < pairs:
                    tag = queue_entry(scratch, PAIRS, first + lane)
                    boxes = eighths_of(scratch, tag, tests_of(kind_of(batch, tag & (BATCH - 1))))
            begin = wp.where(level == 0, PAIRS, ITEMS)
            bits = wp.where(level == 0, FEATURE_BITS, PAIR_BITS)
            total = enqueue(scratch, begin, items, tag, bits, boxes, lane)
            if level == 0:
                pairs = total
                first = int(0)
            else:
                items = total
                first = first + lanes
        else:
            taken = wp.min(lanes, items)
            items = items - taken
            if lane < taken:
                item = queue_entry(scratch, ITEMS, items + lane)
                measure_one(scratch, item, kind_of(batch, item & (BATCH - 1)), room, near, turned, taken, winners)
        wait_for_lanes()


@wp.func
def measure_block(
    tree: Tree,
    features: Features,
    slab: Slab,
    pool: ChunkPool,
    blocks: CandidateLists,
    item: int,
    scratch: wp.uint64,
    stack: wp.array(dtype=wp.int32),
    out: Output,
    block: Block,
    octants: int,
    parts: int,
    shares: int,
    winners: Any,
    lane: int,
    lanes: int,
):
    """Measure a block's `octants` (bits) from the features of list `item`; without one, every voxel is missed.

    They are one of so many `parts`, and the list has so many `shares`.
    """
    write_coordinates(tree, slab, scratch, block, lane, lanes)
    begin_block(slab, out, scratch, block, octants, parts, winners, lane, lanes)
    room = NEAR_ENDS * (block.box.half[0] + block.box.half[1] + block.box.half[2])
    wait_for_lanes()
    reader = Reader()
    if list_length(blocks, item * shares, shares) >= 0:
        if on_cpu() and slab.turned == 0 and by_octants(winners):
            measure_list(tree, features, pool, blocks, item, shares, scratch, block, octants, room)
        else:
            reader = start_reading(blocks, item * shares, shares)
    # Each batch is read while the one before is worked out.
    upcoming = read_entry(pool, reader, lane)
    corners = int(0)
    edges = int(0)
    faces = int(0)
    while reader.left + corners + edges + faces > 0:
        if reader.left > 0 and corners < lanes and edges < lanes and faces < lanes:
            feature = upcoming
            reader = read_on(pool, blocks, reader, lanes)
            upcoming = read_entry(pool, reader, lane)
            which = feature & 7
            code = 4 * (feature >> 3)
            corners = corners + push(stack, CORNERS + corners, feature >= 0 and which < 3, code + which, lane)
            is_edge = feature >= 0 and which >= 3 and which < 6
            edges = edges + push(stack, EDGES + edges, is_edge, code + which - 3, lane)
            faces = faces + push(stack, FACES + faces, feature >= 0 and which == 6, code, lane)
        else:
            batch = next_batch(corners, edges, faces, lanes)
            corners = corners - batch.corners
            edges = edges - batch.edges
            faces = faces - (batch.features - batch.corners - batch.edges)
            which = kind_of(batch, lane)
            there = int(0)
            if lane < batch.features:
                if which == CORNER_KIND:
                    code = stack[CORNERS + corners + lane]
                    add_corner(scratch, lane, tree, features, code, block.box, block.floor)
                    note_feature(scratch, lane, which, code, winners)
                elif which == EDGE_KIND:
                    code = stack[EDGES + edges + lane - batch.corners]
                    add_edge(scratch, lane, tree, features, code, block.box, block.floor)
                    note_feature(scratch, lane, which, code, winners)
                else:
                    code = stack[FACES + faces + lane - batch.corners - batch.edges]
                    add_face(scratch, lane, tree, features, code, block.box, block.floor)
                    note_feature(scratch, lane, which, code, winners)
                there = octants & octants_of(scratch, lane, tests_of(which))
            wait_for_lanes()
            measure_features(scratch, batch, there, room, block.floor == 0.0, slab.turned != 0, winners, lane, lanes)
        wait_for_lanes()
    unclear = end_block(slab, out, scratch, block, octants, parts, winners, lane, lanes)
    if unclear > 0:
        fetch_add(out.ambiguous, block.mesh, unclear)
    wait_for_lanes()


@wp.func
def octants_of_part(part: int, parts: int):
    """The octants of a block, as bits, that are one of its parts."""
    each = 8 / parts
    return ((1 << each) - 1) << (part * each)


@wp.func
def measure_scheduled(
    thread: int,
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
    most_parts: int,
    most_shares: int,
    winners: Any,
):
    """Measure one block after the other, as long as there are any: up to so many parts, from lists of up to so many."""
    lane = thread % lanes
    worker = thread / lanes
    bricks = 8 * schedule.counters[COARSE]
    # Cells of more voxels than a block are measured brick by brick.
    times = wp.where(grid.cell > BLOCK, 8, 1)
    lists = bricks + whole_blocks(schedule)
    boxes = bricks + times * whole_blocks(schedule)
    # As when the lists were made.
    shares = groups_at_work(most_shares, lists)
    parts = groups_at_work(most_parts, boxes)
    total = parts * boxes
    item = fetch_add_once(schedule.counters, NEXT_BLOCK, 1, lane)
    while item < total:
        listed = item / parts
        eighth = int(-1)
        if listed >= bricks and times > 1:
            eighth = (listed - bricks) % 8
            listed = bricks + (listed - bricks) / 8
        block, _number = block_of(tree, slab, grid, cache, schedule, listed, bricks, eighth)
        here = slab_of(slab, block.mesh)
        octants = octants_in_slab(here, block.start, block.bits) & octants_of_part(item % parts, parts)
        if octants != 0 and is_within(here, block.start) and is_wanted(winners, block.start):
            own = worker_scratch(scratch, worker, winners)
            stack = small_stack_of(stacks, worker)
            measure_block(
                tree,
                features,
                here,
                pool,
                blocks,
                listed,
                own,
                stack,
                out,
                block,
                octants,
                parts,
                shares,
                winners,
                lane,
                lanes,
            )
        item = fetch_add_once(schedule.counters, NEXT_BLOCK, 1, lane)


def _measure_blocks_kernel(of_faces: Any, of_grid: Any, of_groups: Any, module: str | None = None) -> Any:
    @wp.kernel(launch_bounds=(128, BLOCKS_PER_SM), enable_backward=False, module=module)
    def _measure_blocks(
        begin: int,
        lanes: int,
        given_tree: Tree,
        features: Features,
        given_slab: Slab,
        grid: RegionGrid,
        cache: CellCache,
        schedule: BlockSchedule,
        pool: ChunkPool,
        blocks: CandidateLists,
        scratch: wp.array(dtype=wp.float32),
        stacks: wp.array(dtype=wp.int32),
        out: Output,
    ):
        tree = of_faces(given_tree)
        slab = of_grid(given_slab)
        thread = begin + wp.tid()
        measure_scheduled(
            thread,
            lanes,
            tree,
            features,
            slab,
            grid,
            cache,
            schedule,
            pool,
            blocks,
            scratch,
            stacks,
            out,
            of_groups(schedule.parts),
            of_groups(blocks.shares),
            NO_WINNERS,
        )

    return _measure_blocks


_MEASURE_BLOCKS = [_measure_blocks_kernel(*own, BY_GROUPS[1]) for own in zip(BY_FACES, BY_GRID, strict=True)]


# In modules of their own, so that who does not ask for them does not wait until they are compiled: small maps, whose
# blocks are shared out, and closest points.
_MEASURE_PARTS = _measure_blocks_kernel(BY_FACES[0], BY_GRID[0], BY_GROUPS[0], "unique")


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM), enable_backward=False, module="unique")
def _measure_winners(
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
):
    thread = begin + wp.tid()
    measure_scheduled(
        thread,
        lanes,
        tree,
        features,
        slab,
        grid,
        cache,
        schedule,
        pool,
        blocks,
        scratch,
        stacks,
        out,
        schedule.parts,
        blocks.shares,
        out.winners,
    )


def scratch_rows(wanted: bool) -> int:
    """Rows of four floats that each worker on a CPU needs, with winners or without."""
    return WINNER_ROWS if wanted else SCRATCH_ROWS


def measure_blocks(
    tree: Tree,
    features: Features,
    slab: Slab,
    grid: RegionGrid,
    cache: CellCache,
    schedule: BlockSchedule,
    pool: ChunkPool,
    blocks: CandidateLists,
    scratch: wp.array,
    stacks: wp.array,
    out: Output,
    workers: int,
    lanes: int,
    kernel: wp.Kernel | None = None,
    more: Sequence[Any] = (),
) -> None:
    """Write the distances of every voxel of one pass to `out`, block by block, with `workers` groups of lanes.

    All else is read; `scratch` and `stacks` are for this alone. Voxels of blocks whose list found no room become
    infinite with their sign, and are counted in `out.missed`. With room for winners in `out` those are written too;
    then no list may be cut into splits. `kernel`, with `more` inputs, measures in the place of those here.
    """
    inputs = [lanes, tree, features, slab, grid, cache, schedule, pool, blocks, scratch, stacks, out, *more]
    alike = not (tree.meshes or slab.meshes)
    plain = _MEASURE_PARTS if schedule.parts > 1 or blocks.shares > 1 else _MEASURE_BLOCKS[alike]
    chosen = kernel or (_measure_winners if out.winners.shape[0] else plain)
    launch(chosen, workers * lanes, inputs, out.values.device, smallest=1)
