"""Stage 5 of the dense query: candidate lists of blocks, the features of triangles that matter to each.

A block is a cell of 8^3 voxels, or a brick of 4^3 of one that is coarse. One group of lanes takes one block, or a split
of its list: it goes from the leaves of the list to their triangles, from those that may be nearest to the features of
them that may be. Each test costs several times the one before, so what passes waits until it fills all lanes.

This is apart from stage 6 because a GPU's caches hold either's instructions, but not both at once.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, UNSCALE, Tree, node_box, nodes_of, tree_of
from sdm.kernels.culling.leaf_filter import (
    FEATURE_STACK,
    NEAR_STACK,
    TRIANGLE_STACK,
    node_matters,
    push,
    push_features,
    push_triangles,
    triangle_matters,
)
from sdm.kernels.culling.normal_cones import Cones
from sdm.kernels.culling.voronoi_features import Features, features_that_matter
from sdm.kernels.culling.witness_bound import (
    LARGEST_SQUARE,
    Witness,
    box_is_farther,
    read_witness,
    read_witness_in_use,
    write_witness,
)
from sdm.kernels.dense.block.voxels import Block
from sdm.kernels.dense.block_schedule import (
    BY_GROUPS,
    LISTING,
    BlockSchedule,
    cell_of,
    groups_at_work,
    split_of,
    splits_of,
    whole_block,
    whole_blocks,
)
from sdm.kernels.dense.cell_cache import CellCache, cached_box, cached_half2
from sdm.kernels.dense.chunk_pool import (
    CandidateLists,
    Chain,
    ChunkPool,
    append,
    list_length,
    read_entry,
    read_on,
    start_reading,
)
from sdm.kernels.dense.counters import COARSE, NEXT_CHUNK, NEXT_LIST
from sdm.kernels.dense.region_grid import RegionGrid, brick_number, brick_start, is_coarse, make_cell
from sdm.kernels.dense.stage4_blocks import nearest_in_list
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import Slab, index_of, slab_of
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.fast_math import about_root
from sdm.kernels.primitives.lanes import wait_for_lanes
from sdm.kernels.primitives.shared_stacks import stack_of

wp.set_module_options({"enable_backward": False})

# Thread blocks that a multiprocessor of a GPU holds.
SELECT_BLOCKS_PER_SM = 4


@wp.func
def floor_of(known: Witness, half2: float):
    """A bound below all distances in a box; 0 if it is not much more than the box's size.

    Args:
        known: The surface point nearest to the box's centre.
        half2: The square of the box's half-diagonal.
    """
    half = wp.sqrt(half2)
    floor = wp.sqrt(known.distance2) - 1.01 * half
    return wp.where(floor > 3.0 * half, floor, 0.0)


@wp.func
def block_of(
    tree: Tree,
    slab: Slab,
    grid: RegionGrid,
    cache: CellCache,
    schedule: BlockSchedule,
    item: int,
    bricks: int,
    eighth: int,
):
    """Block `item`, and its cell's number. The first `bricks` items are bricks of coarse cells.

    If `eighth` is not negative: that brick of a cell which is measured brick by brick from one list.
    """
    code = int(0)
    if item < bricks:
        code = schedule.coarse[item / 8]
    else:
        code = whole_block(schedule, item - bricks)
    number = cell_of(code)
    size = int(grid.cell)
    box = int(number)
    brick = wp.where(item < bricks, item % 8, eighth)
    if brick >= 0:
        size = size / 2
        box = brick_number(grid, number, brick)
    place = cached_box(cache, wp.where(item < bricks, number, box))
    if item < bricks:
        # These are few, and not noted.
        place.start = brick_start(grid, place.start, brick)
        place.box = make_cell(tree, slab, place.mesh, place.start, size)
    block = Block()
    block.mesh = place.mesh
    block.start = place.start
    block.bits = wp.where(size == 4, 2, wp.where(size == 8, 3, 4))
    block.split = split_of(code)
    block.splits = splits_of(code)
    block.unscale = float(tree.frame[block.mesh * FRAME_SIZE + UNSCALE])
    block.box = place.box
    block.known = read_witness_in_use(cache.witnesses, grid.count + box)
    # A brick whose witness is its cell's has its floor from there.
    if eighth >= 0:
        block.floor = floor_of(read_witness(cache.witnesses, grid.count + number), cached_half2(cache, number))
    else:
        block.floor = floor_of(block.known, block.box.half2)
    block.index = index_of(slab_of(slab, block.mesh), block.mesh, block.start)
    return block, number


@wp.func
def find_brick_witness(
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    features: Features,
    grid: RegionGrid,
    pool: ChunkPool,
    cells: CandidateLists,
    cache: CellCache,
    item: int,
    number: int,
    block: Block,
    lane: int,
    lanes: int,
):
    """The surface point nearest to a brick's centre, which is noted for stage 6: distances are taken from it.

    Of several splits each finds the same, whether it begins with the witness of stage 4 or with what another split has
    noted meanwhile. For let w be what the list leads to from the first of them. A lane looks at a triangle only if its
    leaf's box and its ball may be nearer than what the lane knows, which from w on is never more than it was before. So
    what is looked at from w on was looked at before too, and none of it is nearer than w, which stays.
    """
    centre = block.box.centre
    known = nearest_in_list(tree, frames, features, pool, cells, number, block.mesh, centre, block.known, lane, lanes)
    if lane == 0:
        write_witness(cache.witnesses, grid.count + brick_number(grid, number, item % 8), known)
    return known


@wp.func
def select_for(
    tree: Tree,
    features: Features,
    cones: Cones,
    grid: RegionGrid,
    pool: ChunkPool,
    cells: CandidateLists,
    number: int,
    block: Block,
    stack: wp.array(dtype=wp.int32),
    chain: Chain,
    share: int,
    shares: int,
    lane: int,
    lanes: int,
):
    """Add the features that matter to a block of the cell `number` to a chain, which is returned.

    Those of one of `shares` of the leaves of each batch, which is that of so many of the lanes.
    """
    # Read again wherever it is needed, as registers are few.
    leaves = 1 << tree_of(tree, block.mesh).depth
    reader = start_reading(cells, number * cells.shares, cells.shares)
    # Each batch is read while the one before is tested.
    upcoming = read_entry(pool, reader, lane)
    batch = int(0)
    waiting = int(0)
    ripe = int(0)
    found = int(0)
    while reader.left + waiting + ripe + found > 0 and chain.chunk < pool.chunks:
        if found >= lanes or reader.left + waiting + ripe == 0:
            taken = wp.min(lanes, found)
            found = found - taken
            feature = int(0)
            if lane < taken:
                feature = stack[FEATURE_STACK + found + lane]
            chain = append(pool, chain, lane < taken, feature, lane)
        elif ripe >= lanes or reader.left + waiting == 0:
            taken = wp.min(lanes, ripe)
            ripe = ripe - taken
            which = int(0)
            slot = int(0)
            if lane < taken:
                slot = stack[NEAR_STACK + ripe + lane]
                which = features_that_matter(block.box, block.known, tree, features, slot)
            found = push_features(stack, FEATURE_STACK + found, slot, which, lane) - FEATURE_STACK
        elif waiting >= lanes or reader.left == 0:
            taken = wp.min(lanes, waiting)
            waiting = waiting - taken
            keep = False
            slot = int(0)
            if lane < taken:
                slot = stack[TRIANGLE_STACK + waiting + lane]
                radius = about_root(block.box.half2)
                keep = triangle_matters(block.box, radius, block.known, tree, features.balls, cones, slot)
            ripe = ripe + push(stack, NEAR_STACK + ripe, keep, slot, lane)
        else:
            leaf = upcoming
            reader = read_on(pool, cells, reader, lanes)
            upcoming = read_entry(pool, reader, lane)
            keep = leaf >= 0 and batch % block.splits == block.split and lane % shares == share
            if keep:
                base = nodes_of(tree_of(tree, block.mesh), block.mesh)
                if (1 << block.bits) < grid.cell:
                    radius = about_root(block.box.half2)
                    one = tree_of(tree, block.mesh)
                    keep = node_matters(block.box, radius, block.known, one, cones, base, leaves + leaf)
                else:
                    # For the cell it has been tested, but with a witness that may not have been the nearest.
                    low, high = node_box(tree, base + leaves + leaf)
                    keep = not box_is_farther(block.box, block.known, low, high)
            waiting = (
                push_triangles(stack, TRIANGLE_STACK + waiting, tree_of(tree, block.mesh), block.mesh, keep, leaf, lane)
                - TRIANGLE_STACK
            )
            batch = batch + 1
        wait_for_lanes()
    return chain


def _select_features_kernel(of_groups: Any, module: str | None = None) -> Any:
    @wp.kernel(launch_bounds=(128, SELECT_BLOCKS_PER_SM), enable_backward=False, module=module)
    def _select_features(
        begin: int,
        lanes: int,
        tree: Tree,
        frames: wp.array(dtype=wp.float32),
        features: Features,
        cones: Cones,
        slab: Slab,
        grid: RegionGrid,
        pool: ChunkPool,
        cells: CandidateLists,
        cache: CellCache,
        schedule: BlockSchedule,
        blocks: CandidateLists,
        stacks: wp.array(dtype=wp.int32),
    ):
        thread = begin + wp.tid()
        lane = thread % lanes
        bricks = 8 * schedule.counters[COARSE]
        total = int(bricks)
        if grid.by_brick == 0:
            total = total + whole_blocks(schedule)
        groups = groups_at_work(of_groups(blocks.shares), total, LISTING)
        stack = stack_of(stacks, thread / lanes)
        item = fetch_add_once(pool.counters, NEXT_LIST, 1, lane)
        while item < total * groups:
            listed = item / groups
            # Of bricks, which look for a witness first, one group makes the whole list.
            share = item % groups
            shares = wp.where(listed < bricks, 1, groups)
            block, number = block_of(tree, slab, grid, cache, schedule, listed, bricks, -1)
            within = is_within(slab_of(slab, block.mesh), block.start)
            head = int(-1)
            lacking = False
            chain = Chain()
            chain.chunk = pool.chunks
            length = list_length(cells, number * cells.shares, cells.shares)
            if share >= shares:
                # An empty part of the list.
                head = 0
            if within and length > 0 and block.known.distance2 < LARGEST_SQUARE and share < shares:
                if not is_coarse(tree, block.mesh, block.box):
                    if listed < bricks:
                        block.known = find_brick_witness(
                            tree_of(tree, block.mesh),
                            frames,
                            features,
                            grid,
                            pool,
                            cells,
                            cache,
                            listed,
                            number,
                            block,
                            lane,
                            lanes,
                        )
                    head = pool.reserved + fetch_add_once(pool.counters, NEXT_CHUNK, 1, lane)
                    chain.chunk = head
                    chain = select_for(
                        tree,
                        features,
                        cones,
                        grid,
                        pool,
                        cells,
                        number,
                        block,
                        stack,
                        chain,
                        share,
                        shares,
                        lane,
                        lanes,
                    )
                    lacking = chain.chunk >= pool.chunks
            if lane == 0:
                if lacking and block.splits > 1:
                    # What the other splits come to is not all. Bricks that are too coarse lack nothing: no split
                    # measures them, and if the cell's other bricks were searched with them, bits would depend on
                    # splits.
                    schedule.lacking[number] = 1
                blocks.heads[item] = wp.where(chain.chunk < pool.chunks or share >= shares, head, -1)
                blocks.lengths[item] = chain.length
            item = fetch_add_once(pool.counters, NEXT_LIST, 1, lane)

    return _select_features


_SELECT_FEATURES = _select_features_kernel(BY_GROUPS[1])
# In a module of its own, so that who has no small maps does not wait until it is compiled.
_SELECT_SHARES = _select_features_kernel(BY_GROUPS[0], "unique")


def select_features(
    tree: Tree,
    frames: wp.array,
    features: Features,
    cones: Cones,
    slab: Slab,
    grid: RegionGrid,
    pool: ChunkPool,
    cells: CandidateLists,
    cache: CellCache,
    schedule: BlockSchedule,
    blocks: CandidateLists,
    stacks: wp.array,
    workers: int,
    lanes: int,
) -> None:
    """Write the blocks' lists of one pass, into the pool, from the cells' lists and in the order of the schedule.

    And the witnesses of bricks of coarse cells, and which split cells lack room. `workers` groups of lanes are at
    work; `stacks` is scratch, see `shared_stacks`.
    """
    inputs = [lanes, tree, frames, features, cones, slab, grid, pool, cells, cache, schedule, blocks, stacks]
    kernel = _SELECT_FEATURES if blocks.shares == 1 else _SELECT_SHARES
    launch(kernel, workers * lanes, inputs, frames.device, smallest=1)
