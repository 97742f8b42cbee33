"""First stage of the dense query: for each region of 16^3 voxels, the leaves of the tree that matter to it.

One group of lanes descends the tree for one region, a batch of nodes at a time.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cull import Cell, Witness, agree, away, box_is_behind, no_witness, remember
from sdm.kernels.frames import load_frame, see
from sdm.kernels.grid import Slab
from sdm.kernels.lanes import ballot, fetch_add_once, members, rank, wait_for_lanes
from sdm.kernels.lists import NEXT_CHUNK, NEXT_REGION, REGION, Chain, Lists, append, make_cell, region_start
from sdm.kernels.tree import FRAME_SIZE, SCALE, Tree, first_triangle, node_box, node_distance2

wp.set_module_options({"enable_backward": False})

# Every batch of 32 nodes leaves at most 32 more on the stack than it took, at each of up to 27 levels; leaves that
# wait, at most 32 and the 64 of one batch, grow from the other end.
STACK = 1024
# Sides on which a region looks for witnesses before it descends.
PROBES = wp.constant(32)

_STACK = wp.constant(STACK)
_NEXT_REGION = wp.constant(NEXT_REGION)
_NEXT_CHUNK = wp.constant(NEXT_CHUNK)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)


@wp.func
def greedy_leaf(tree: Tree, mesh: int, p: wp.vec3):
    """A leaf near p: always the nearer child. Its triangles give a first bound."""
    base = mesh * (2 << tree.depth)
    node = int(1)
    for _level in range(tree.depth):
        left = base + 2 * node
        left2 = node_distance2(tree, left, p)
        right2 = node_distance2(tree, left + 1, p)
        node = 2 * node + wp.where(right2 < left2, 1, 0)
    return node - (1 << tree.depth)


@wp.func
def probe_direction(probe: int):
    """Directions spread evenly over the sphere (a Fibonacci lattice)."""
    turn = 2.399963 * float(probe)
    z = 1.0 - (2.0 * float(probe % PROBES) + 1.0) / float(PROBES)
    r = wp.sqrt(1.0 - z * z)
    return wp.vec3(r * wp.cos(turn), r * wp.sin(turn), z)


@wp.func
def seen_from(frames: wp.array(dtype=wp.float32), slot: int, centre: wp.vec3):
    """The vector from a triangle's closest point to a centre."""
    f = load_frame(frames, slot)
    return away(f, see(f, centre))


@wp.func
def node_matters(cell: Cell, known: Witness, tree: Tree, node: int):
    """Whether something in a node's box can be nearest to a voxel of the cell."""
    low, high = node_box(tree, node)
    return not box_is_behind(cell, known, low, high)


@wp.kernel
def _list_regions(
    begin: int,
    lanes: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    slab: Slab,
    lists: Lists,
    stacks: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = (thread / lanes) * _STACK
    leaves = 1 << tree.depth
    item = fetch_add_once(lists.counts, _NEXT_REGION, 1, lane)
    while item < lists.count:
        mesh, start = region_start(lists, item)
        base = mesh * 2 * leaves
        cell = make_cell(slab, start, REGION, float(tree.frame[mesh * _FRAME_SIZE + _SCALE]))
        known = no_witness()
        # The lanes look for witnesses on all sides: at the centre, then as far from it as the surface is.
        reach = float(0.0)
        probe = lane
        while probe < PROBES + lanes:
            leaf = greedy_leaf(tree, mesh, cell.centre + reach * probe_direction(probe))
            for t in range(first_triangle(tree, leaf), first_triangle(tree, leaf + 1)):
                known = remember(known, seen_from(frames, mesh * tree.count + t, cell.centre))
            known = agree(known, lane)
            reach = wp.sqrt(known.distance2)
            probe = probe + lanes
        chain = Chain()
        chain.chunk = fetch_add_once(lists.counts, _NEXT_CHUNK, 1, lane)
        head = chain.chunk
        # The level of the tree that is as wide as the lanes are many is where the descent begins.
        waiting = wp.min(lanes, leaves)
        ripe = int(0)
        if lane < waiting:
            if waiting < leaves:
                stacks[stack + lane] = waiting + lane
            else:
                stacks[stack + _STACK - 1 - lane] = waiting + lane
        if waiting == leaves:
            ripe = waiting
            waiting = int(0)
        wait_for_lanes()
        while waiting + ripe > 0 and chain.chunk < lists.chunks:
            # Inner nodes are taken until the leaves that were found fill all lanes.
            if waiting > 0 and ripe < lanes:
                taken = wp.min(lanes, waiting)
                waiting = waiting - taken
                node = int(0)
                if lane < taken:
                    node = stacks[stack + waiting + lane]
                wait_for_lanes()
                for side in range(2):
                    child = 2 * node + side
                    keep = False
                    if node > 0:
                        keep = node_matters(cell, known, tree, base + child)
                    mask = ballot(keep and child < leaves)
                    if keep and child < leaves:
                        stacks[stack + waiting + rank(mask, lane)] = child
                    waiting = waiting + members(mask)
                    mask = ballot(keep and child >= leaves)
                    if keep and child >= leaves:
                        stacks[stack + _STACK - 1 - ripe - rank(mask, lane)] = child
                    ripe = ripe + members(mask)
            else:
                taken = wp.min(lanes, ripe)
                ripe = ripe - taken
                leaf = int(-1)
                mine = known
                if lane < taken:
                    leaf = stacks[stack + _STACK - 1 - ripe - lane] - leaves
                    # One of its triangles may be the better witness.
                    t = first_triangle(tree, leaf)
                    if t < first_triangle(tree, leaf + 1):
                        mine = remember(mine, seen_from(frames, mesh * tree.count + t, cell.centre))
                known = agree(mine, lane)
                keep = False
                if leaf >= 0:
                    keep = node_matters(cell, known, tree, base + leaves + leaf)
                chain = append(lists, chain, keep, leaf, lane)
            wait_for_lanes()
        if lane == 0:
            lists.region_heads[item] = wp.where(chain.chunk < lists.chunks, head, -1)
            lists.region_lengths[item] = chain.length
        item = fetch_add_once(lists.counts, _NEXT_REGION, 1, lane)


def list_regions(
    tree: Tree, frames: wp.array, slab: Slab, lists: Lists, stacks: wp.array, workers: int, lanes: int, launch: Any
) -> None:
    """Fill the regions' lists of one pass, `workers` groups of lanes at work; `stacks` (workers * STACK) is scratch."""
    launch(_list_regions, workers * lanes, [lanes, tree, frames, slab, lists, stacks], frames.device, smallest=1)
