"""Stage 5 of the dense query for cells of 16^3 voxels: a list of features for each of a cell's eight bricks.

As `stage5_select`, from leaves to triangles to features, once for the cell; then each feature is asked which bricks it
matters to. A long list is the work of several groups, each of which takes a split of it and makes chains of its own.
Stage 6 reads a brick's one after the other, so that no voxel is measured twice; of very long lists only some.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree, node_box, nodes_of, tree_of
from sdm.kernels.culling.leaf_filter import (
    FEATURE_STACK,
    NEAR_STACK,
    TRIANGLE_STACK,
    push,
    push_features,
    push_triangles,
    triangle_matters,
)
from sdm.kernels.culling.normal_cones import Cones
from sdm.kernels.culling.voronoi_features import Features, features_that_matter
from sdm.kernels.culling.witness_bound import LARGEST_SQUARE, Witness, box_is_farther, read_witness
from sdm.kernels.dense.block.octant_tests import write_lattice
from sdm.kernels.dense.block_schedule import BlockSchedule, cell_of, split_of, splits_of, whole_block, whole_blocks
from sdm.kernels.dense.bricks.brick_chains import append_to, begin_chains, end_chains
from sdm.kernels.dense.bricks.brick_tests import (
    begin_witnesses,
    bricks_in_slab,
    bricks_that_matter,
    end_witnesses,
    test_scratch_of,
)
from sdm.kernels.dense.cell_cache import CellCache, cached_box
from sdm.kernels.dense.chunk_pool import CandidateLists, ChunkPool, list_length, read_entry, read_on, start_reading
from sdm.kernels.dense.counters import COARSE, NEXT_BRICK_LISTS
from sdm.kernels.dense.region_grid import RegionGrid
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.geometry.voxel_grid import Slab, slab_of
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.fast_math import about_root
from sdm.kernels.primitives.lanes import wait_for_lanes
from sdm.kernels.primitives.shared_stacks import stack_of

wp.set_module_options({"enable_backward": False})

# Thread blocks that a multiprocessor of a GPU holds.
BRICK_BLOCKS_PER_SM = 4


@wp.func
def select_for_bricks(
    tree: Tree,
    features: Features,
    cones: Cones,
    pool: ChunkPool,
    cells: CandidateLists,
    number: int,
    mesh: int,
    box: VoxelBox,
    known: Witness,
    there: int,
    split: int,
    splits: int,
    scratch: wp.uint64,
    stack: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
):
    """Add the features that matter to the bricks `there` (bits) of the cell `number` to their chains.

    Those of every `splits`-th batch of the cell's leaves, from `split` on.
    """
    # Read again wherever it is needed, as registers are few.
    leaves = 1 << tree_of(tree, mesh).depth
    reader = start_reading(cells, number * cells.shares, cells.shares)
    # Each batch is read while the one before is tested.
    upcoming = read_entry(pool, reader, lane)
    batch = int(0)
    waiting = int(0)
    ripe = int(0)
    found = int(0)
    while reader.left + waiting + ripe + found > 0:
        if found >= lanes or reader.left + waiting + ripe == 0:
            taken = wp.min(lanes, found)
            found = found - taken
            feature = int(0)
            if lane < taken:
                feature = stack[FEATURE_STACK + found + lane]
            which = there & bricks_that_matter(scratch, tree, features, box, feature, taken, lane)
            append_to(pool.entries, pool.counters, pool.chunks, pool.reserved, stack, which, feature, lane)
        elif ripe >= lanes or reader.left + waiting == 0:
            taken = wp.min(lanes, ripe)
            ripe = ripe - taken
            which = int(0)
            slot = int(0)
            if lane < taken:
                slot = stack[NEAR_STACK + ripe + lane]
                which = features_that_matter(box, known, tree, features, slot)
            found = push_features(stack, FEATURE_STACK + found, slot, which, lane) - FEATURE_STACK
        elif waiting >= lanes or reader.left == 0:
            taken = wp.min(lanes, waiting)
            waiting = waiting - taken
            keep = False
            slot = int(0)
            if lane < taken:
                slot = stack[TRIANGLE_STACK + waiting + lane]
                radius = about_root(box.half2)
                keep = triangle_matters(box, radius, known, tree, features.balls, cones, slot)
            ripe = ripe + push(stack, NEAR_STACK + ripe, keep, slot, lane)
        else:
            leaf = upcoming
            reader = read_on(pool, cells, reader, lanes)
            upcoming = read_entry(pool, reader, lane)
            keep = leaf >= 0 and batch % splits == split
            if keep:
                # It has been tested, but with a witness that may not have been the nearest.
                low, high = node_box(tree, nodes_of(tree_of(tree, mesh), mesh) + leaves + leaf)
                keep = not box_is_farther(box, known, low, high)
            waiting = (
                push_triangles(stack, TRIANGLE_STACK + waiting, tree_of(tree, mesh), mesh, keep, leaf, lane)
                - TRIANGLE_STACK
            )
            batch = batch + 1
        wait_for_lanes()


# In a module of its own, so that who has no such cells does not wait until it is compiled.
@wp.kernel(launch_bounds=(128, BRICK_BLOCKS_PER_SM), enable_backward=False, module="unique")
def _select_bricks(
    begin: int,
    lanes: int,
    tree: Tree,
    features: Features,
    cones: Cones,
    slab: Slab,
    grid: RegionGrid,
    pool: ChunkPool,
    cells: CandidateLists,
    cache: CellCache,
    schedule: BlockSchedule,
    blocks: CandidateLists,
    scratch: wp.array(dtype=wp.float32),
    stacks: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    total = whole_blocks(schedule)
    stack = stack_of(stacks, thread / lanes)
    own = test_scratch_of(scratch, thread / lanes)
    item = fetch_add_once(pool.counters, NEXT_BRICK_LISTS, 1, lane)
    while item < total:
        code = whole_block(schedule, item)
        number = cell_of(code)
        split = split_of(code)
        splits = splits_of(code)
        place = cached_box(cache, number)
        known = read_witness(cache.witnesses, grid.count + number)
        head = int(-1)
        length = list_length(cells, number * cells.shares, cells.shares)
        if length > 0 and known.distance2 < LARGEST_SQUARE:
            head = begin_chains(pool, stack, lane, lanes)
            here = slab_of(slab, place.mesh)
            there = bricks_in_slab(here, place.start)
            begin_witnesses(own, grid, cache, number, place.box.centre, there, lane, lanes)
            scale = tree.frame[place.mesh * FRAME_SIZE + SCALE]
            write_lattice(here, own, place.start, place.box, scale, lane, lanes)
            wait_for_lanes()
            select_for_bricks(
                tree,
                features,
                cones,
                pool,
                cells,
                number,
                place.mesh,
                place.box,
                known,
                there,
                split,
                splits,
                own,
                stack,
                lane,
                lanes,
            )
            end_witnesses(own, grid, cache, number, lane, lanes)
        # The chains of one brick lie side by side, split by split.
        first = 8 * (schedule.counters[COARSE] + item - split) + split
        lacking = end_chains(pool, stack, blocks, first, splits, head, lane, lanes)
        if lacking > 0 and head >= 0 and splits > schedule.at_once:
            # What the other splits come to is not all.
            schedule.lacking[number] = 1
        wait_for_lanes()
        item = fetch_add_once(pool.counters, NEXT_BRICK_LISTS, 1, lane)


def select_bricks(
    tree: Tree,
    features: Features,
    cones: Cones,
    slab: Slab,
    grid: RegionGrid,
    pool: ChunkPool,
    cells: CandidateLists,
    cache: CellCache,
    schedule: BlockSchedule,
    blocks: CandidateLists,
    scratch: wp.array,
    stacks: wp.array,
    workers: int,
    lanes: int,
) -> None:
    """Write the lists of the bricks of one pass, into the pool, from the cells' lists, and better witnesses of bricks.

    Not of coarse cells, whose bricks are left to `select_features`. `workers` groups of lanes are at work; `scratch`
    and `stacks` are for this alone.
    """
    inputs = [lanes, tree, features, cones, slab, grid, pool, cells, cache, schedule, blocks, scratch, stacks]
    launch(_select_bricks, workers * lanes, inputs, scratch.device, smallest=1)
