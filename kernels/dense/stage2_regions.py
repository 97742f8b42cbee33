"""Stage 2 of the dense query: candidate lists of regions, the leaves of the tree that matter to each.

One group of lanes descends the tree for one region, or one share of the tree, a batch of nodes at a time.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, node_box, nodes_of, tree_of
from sdm.kernels.culling.leaf_filter import node_matters, push
from sdm.kernels.culling.normal_cones import Cones
from sdm.kernels.culling.witness_bound import read_witness
from sdm.kernels.dense.cell_cache import CellCache, cached_region, is_left_out
from sdm.kernels.dense.chunk_pool import CandidateLists, Chain, ChunkPool, append
from sdm.kernels.dense.counters import NEXT_REGION
from sdm.kernels.dense.region_grid import RegionGrid, make_cell, own_shares
from sdm.kernels.dense.stage1_witnesses import nearer_of_leaves
from sdm.kernels.geometry.voxel_grid import REGION_SHARES, Slab
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.lanes import ballot, members, rank, wait_for_lanes
from sdm.kernels.primitives.shared_stacks import STACK, stack_of

wp.set_module_options({"enable_backward": False})

# Thread blocks that a multiprocessor of a GPU holds: this kernel waits for memory more than it works.
REGION_BLOCKS_PER_SM = 6

# With more shares each has too few nodes to fill its lanes from.
MOST_WITH_GRANDCHILDREN = 8


@wp.kernel(launch_bounds=(128, REGION_BLOCKS_PER_SM))
def _list_regions(
    begin: int,
    lanes: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    cones: Cones,
    slab: Slab,
    grid: RegionGrid,
    cache: CellCache,
    pool: ChunkPool,
    regions: CandidateLists,
    stacks: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = stack_of(stacks, thread / lanes)
    item = fetch_add_once(pool.counters, NEXT_REGION, 1, lane)
    while item < grid.count * regions.shares:
        region = item / regions.shares
        mesh, start = cached_region(cache, region)
        # Read again wherever it is needed, as registers are few.
        leaves = 1 << tree_of(tree, mesh).depth
        base = nodes_of(tree_of(tree, mesh), mesh)
        cell = make_cell(tree, slab, mesh, start, 2 * grid.cell)
        radius = wp.sqrt(cell.half2)
        known = read_witness(cache.witnesses, region)
        chain = Chain()
        chain.chunk = item
        shares = own_shares(slab, mesh, REGION_SHARES, regions.shares)
        share = item % regions.shares
        # So many lanes for a node: for its children, or where few groups share a list for its grandchildren, as what
        # their parents' tests would drop, their own do too. Either lie side by side in memory.
        fan = wp.where(shares > MOST_WITH_GRANDCHILDREN, 2, 4)
        # The level of the tree that is as wide as the lanes of all shares are many is where the descent begins.
        top = wp.min(lanes * shares, leaves)
        first = top * share / shares
        # Beyond the mesh's own shares there is nothing to do, nor without a region.
        waiting = wp.where(share < shares and not is_left_out(start), top * (share + 1) / shares - first, 0)
        ripe = int(0)
        if lane < waiting:
            if top < leaves:
                stack[lane] = top + first + lane
            else:
                stack[STACK - 1 - lane] = top + first + lane
        if top == leaves:
            ripe = waiting
            waiting = int(0)
        wait_for_lanes()
        while waiting + ripe > 0 and chain.chunk < pool.chunks:
            # Inner nodes are taken until the leaves that were found fill all lanes.
            if waiting > 0 and ripe < lanes:
                taken = wp.min(wp.max(lanes / fan, 1), waiting)
                waiting = waiting - taken
                node = int(0)
                i = lane
                kept = int(0)
                if lane < fan * taken:
                    node = stack[waiting + lane / fan]
                wait_for_lanes()
                while i - lane < fan * taken:
                    child = fan * node + (i & (fan - 1))
                    there = node > 0
                    if 2 * node >= leaves:
                        # Above the leaves there are only two children.
                        child = 2 * node + (i & 1)
                        there = there and (i & (fan - 1)) < 2
                    keep = False
                    if there:
                        keep = node_matters(cell, radius, known, tree_of(tree, mesh), cones, base, child)
                    kept = kept + push(stack, waiting + kept, keep and child < leaves, child, lane)
                    mask = ballot(keep and child >= leaves)
                    if keep and child >= leaves:
                        stack[STACK - 1 - ripe - rank(mask, lane)] = child
                    ripe = ripe + members(mask)
                    i = i + lanes
                waiting = waiting + kept
            else:
                taken = wp.min(lanes, ripe)
                ripe = ripe - taken
                leaf = int(-1)
                low = wp.vec3()
                high = wp.vec3()
                if lane < taken:
                    leaf = stack[STACK - 1 - ripe - lane] - leaves
                    low, high = node_box(tree, base + leaves + leaf)
                one = tree_of(tree, mesh)
                known = nearer_of_leaves(one, frames, mesh, leaf, low, high, cell.centre, known, lane)
                chain = append(pool, chain, leaf >= 0, leaf, lane)
            wait_for_lanes()
        if lane == 0:
            regions.heads[item] = wp.where(chain.chunk < pool.chunks, item, -1)
            regions.lengths[item] = chain.length
        item = fetch_add_once(pool.counters, NEXT_REGION, 1, lane)


def list_regions(
    tree: Tree,
    frames: wp.array,
    cones: Cones,
    slab: Slab,
    grid: RegionGrid,
    cache: CellCache,
    pool: ChunkPool,
    regions: CandidateLists,
    stacks: wp.array,
    workers: int,
    lanes: int,
) -> None:
    """Write the regions' lists of one pass, into the pool, by the regions' witnesses in the cache.

    `workers` groups of lanes are at work; `stacks` is scratch, see `shared_stacks`.
    """
    inputs = [lanes, tree, frames, cones, slab, grid, cache, pool, regions, stacks]
    launch(_list_regions, workers * lanes, inputs, frames.device, smallest=1)
