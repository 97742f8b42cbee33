"""Stage 6 of the dense query: the distances themselves, block by block.

One group of lanes takes one block, or a split of its list of features, see `block.measuring`; where blocks are few all
groups of a thread block do, see `block.together`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import BY_FACES, Tree
from sdm.kernels.culling.voronoi_features import Features
from sdm.kernels.dense.block.measuring import measure_block
from sdm.kernels.dense.block.octant_tests import octants_in_slab
from sdm.kernels.dense.block.shared_layout import SCRATCH_ROWS
from sdm.kernels.dense.block.together import first_together, measure_together, next_together
from sdm.kernels.dense.block.winners import NO_WINNERS, WINNER_ROWS, is_wanted, worker_scratch
from sdm.kernels.dense.block_schedule import BUSY, BY_GROUPS, LISTING, BlockSchedule, groups_at_work, whole_blocks
from sdm.kernels.dense.cell_cache import CellCache
from sdm.kernels.dense.chunk_pool import CandidateLists, ChunkPool
from sdm.kernels.dense.counters import COARSE, NEXT_BLOCK
from sdm.kernels.dense.region_grid import BLOCK, RegionGrid
from sdm.kernels.dense.stage5_select import block_of
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import BY_GRID, Output, Slab, slab_of
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import ask_for_next, fetch_add_once
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, gpu_workers, int_from_lane
from sdm.kernels.primitives.shared_stacks import small_stack_of

wp.set_module_options({"enable_backward": False})

# Thread blocks that a multiprocessor of a GPU holds, if grids may differ and if they do not: what is read of grids that
# differ costs registers, and what others need for winning features memory.
MEASURE_BLOCKS_PER_SM = BLOCKS_PER_SM, 5


@wp.func
def octants_of_part(part: int, parts: int):
    """The octants of a block, as bits, that are one of its parts."""
    each = 8 / parts
    return ((1 << each) - 1) << (part * each)


@wp.func
def blocks_to_measure(grid: RegionGrid, schedule: BlockSchedule, bricks: int):
    """Number of blocks, of which the first are `bricks` of coarse cells: larger cells are measured brick by brick."""
    return bricks + wp.where(grid.cell > BLOCK, 8, 1) * whole_blocks(schedule)


@wp.func
def list_of(grid: RegionGrid, item: int, bricks: int):
    """The list of block `item` of those, and which brick of the list's cell it is; -1 for the cell itself."""
    listed = int(item)
    eighth = int(-1)
    if item >= bricks and grid.cell > BLOCK:
        eighth = (item - bricks) % 8
        listed = bricks + (item - bricks) / 8
    return listed, eighth


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
    lists = bricks + whole_blocks(schedule)
    boxes = blocks_to_measure(grid, schedule, bricks)
    # As when the lists were made.
    shares = groups_at_work(most_shares, lists, LISTING)
    parts = groups_at_work(most_parts, boxes, BUSY)
    total = parts * boxes
    item = fetch_add_once(schedule.counters, NEXT_BLOCK, 1, lane)
    while item < total:
        # Asked for while this one is measured, as it takes a while.
        following = ask_for_next(schedule.counters, NEXT_BLOCK, lane)
        listed, eighth = list_of(grid, item / parts, bricks)
        block, _number = block_of(tree, slab, grid, cache, schedule, listed, bricks, eighth)
        here = slab_of(slab, block.mesh)
        octants = octants_in_slab(here, block.start, block.bits) & octants_of_part(item % parts, parts)
        chains = int(shares)
        first = listed * shares
        if grid.by_brick != 0 and eighth >= 0:
            # So many of a brick's chains, which lie side by side, are one block's: see `select_bricks`.
            at_once = schedule.at_once
            first = bricks + 8 * (listed - bricks - block.split) + eighth * block.splits + block.split
            chains = wp.min(at_once, block.splits - block.split)
            octants = wp.where(block.split % at_once == 0, octants, 0)
            block.splits = wp.where(block.splits > at_once, block.splits, 1)
        if octants != 0 and is_within(here, block.start) and is_wanted(winners, block.start):
            own = worker_scratch(scratch, worker, winners)
            stack = small_stack_of(stacks, worker)
            measure_block(
                tree,
                features,
                here,
                pool,
                blocks,
                first,
                own,
                stack,
                out,
                block,
                octants,
                parts,
                chains,
                winners,
                lane,
                lanes,
            )
        item = int_from_lane(following, 0)


def _measure_blocks_kernel(
    of_faces: Any, of_grid: Any, blocks_per_sm: int, of_groups: Any, module: str | None = None
) -> Any:
    @wp.kernel(launch_bounds=(128, blocks_per_sm), enable_backward=False, module=module)
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
            1,
            of_groups(blocks.shares),
            NO_WINNERS,
        )

    return _measure_blocks


_MEASURE_BLOCKS = [
    _measure_blocks_kernel(*own, BY_GROUPS[1]) for own in zip(BY_FACES, BY_GRID, MEASURE_BLOCKS_PER_SM, strict=True)
]


# In modules of their own, so that who does not ask for them does not wait until they are compiled: small maps, whose
# lists are made by several groups and whose blocks are measured by several, and closest points.
_MEASURE_SHARES = _measure_blocks_kernel(BY_FACES[0], BY_GRID[0], BLOCKS_PER_SM, BY_GROUPS[0], "unique")


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM), enable_backward=False, module="unique")
def _measure_together(
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
    bricks = 8 * schedule.counters[COARSE]
    lists = bricks + whole_blocks(schedule)
    total = blocks_to_measure(grid, schedule, bricks)
    shares = groups_at_work(blocks.shares, lists, LISTING)
    item = first_together(schedule.counters, NEXT_BLOCK)
    while item < total:
        listed, eighth = list_of(grid, item, bricks)
        block, _number = block_of(tree, slab, grid, cache, schedule, listed, bricks, eighth)
        here = slab_of(slab, block.mesh)
        octants = octants_in_slab(here, block.start, block.bits)
        if octants != 0 and is_within(here, block.start):
            measure_together(
                tree, features, here, pool, blocks, listed, scratch, out, block, octants, shares, thread, lanes
            )
        item = next_together(schedule.counters, NEXT_BLOCK, total)


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
    """Write the distances of every voxel of one pass to `out`, block by block, with `workers` groups of lanes, or more.

    All else is read; `scratch` and `stacks` are for this alone. Voxels of blocks whose list found no room become
    infinite with their sign, and are counted in `out.missed`. With room for winners in `out` those are written too;
    then no list may be cut into splits. `kernel`, with `more` inputs, measures in the place of those here.
    """
    inputs = [lanes, tree, features, slab, grid, cache, schedule, pool, blocks, scratch, stacks, out, *more]
    alike = not (tree.meshes or slab.meshes)
    plain = _MEASURE_BLOCKS[alike] if blocks.shares == 1 else _MEASURE_SHARES
    plain = _measure_together if schedule.together else plain
    chosen = kernel or (_measure_winners if out.winners.shape[0] else plain)
    device = out.values.device
    if device.is_cuda and chosen is _MEASURE_BLOCKS[True]:
        workers = gpu_workers(device, MEASURE_BLOCKS_PER_SM[True])
    launch(chosen, workers * lanes, inputs, device, smallest=1)
