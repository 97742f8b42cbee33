"""Second stage of the dense query: for each cell of 8^3 voxels, the triangles that matter to it.

One group of lanes takes one cell: it tests the boxes of the leaves in its region's list, then the triangles of those
that are left, and their parts.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cull import agree, away, ball_is_behind, no_witness, remember, triangle_is_behind
from sdm.kernels.frames import load_frame, see
from sdm.kernels.grid import Slab
from sdm.kernels.lanes import (
    GPU_BLOCKS,
    ballot,
    fetch_add,
    fetch_add_once,
    group_of_least,
    load4,
    members,
    on_cpu,
    rank,
    wait_for_lanes,
)
from sdm.kernels.lists import (
    CELL,
    CHUNK,
    HEAVY,
    NEXT_CELL,
    NEXT_CHUNK,
    ROOM,
    Chain,
    Lists,
    append,
    cell_start,
    is_coarse,
    is_within,
    make_cell,
)
from sdm.kernels.parts import Parts, parts_that_matter
from sdm.kernels.regions import STACK, node_matters, seen_from
from sdm.kernels.tree import FRAME_SIZE, SCALE, TRIANGLES_PER_LEAF, Tree, first_triangle, node_distance2

wp.set_module_options({"enable_backward": False})

_CHUNK = wp.constant(CHUNK)
_ROOM = wp.constant(ROOM)
_STACK = wp.constant(STACK)
_NEXT_CELL = wp.constant(NEXT_CELL)
_NEXT_CHUNK = wp.constant(NEXT_CHUNK)
_HEAVY = wp.constant(HEAVY)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
_LEAF = wp.constant(TRIANGLES_PER_LEAF)


@wp.func
def nearest_box(tree: Tree, base: int, lists: Lists, item: int, centre: wp.vec3, lane: int, lanes: int):
    """Of the leaves that one lane sees of a region's list, the one whose box is nearest."""
    best = int(0)
    best2 = float(wp.inf)
    chunk = lists.region_heads[item]
    left = lists.region_lengths[item]
    while left > 0:
        taken = wp.min(left, _ROOM)
        i = lane
        while i < taken:
            leaf = lists.pool[chunk * _CHUNK + i]
            node = base + (1 << tree.depth) + leaf
            d2 = node_distance2(tree, node, centre)
            if d2 < best2:
                best2 = d2
                best = leaf
            i = i + lanes
        left = left - taken
        if left > 0:
            chunk = lists.pool[chunk * _CHUNK + _ROOM]
    return best, best2


@wp.kernel(launch_bounds=(128, GPU_BLOCKS))
def _list_cells(
    begin: int,
    lanes: int,
    longest: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    parts: Parts,
    slab: Slab,
    lists: Lists,
    stacks: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = (thread / lanes) * _STACK
    leaves = 1 << tree.depth
    item = fetch_add_once(lists.counts, _NEXT_CELL, 1, lane)
    while item < 8 * lists.count:
        mesh, start = cell_start(lists, item)
        region = item / 8
        if is_within(slab, start):
            base = mesh * 2 * leaves
            cell = make_cell(slab, start, CELL, float(tree.frame[mesh * _FRAME_SIZE + _SCALE]))
            known = no_witness()
            chain = Chain()
            chain.chunk = lists.chunks
            head = int(-1)
            chunk = lists.region_heads[region]
            left = int(0)
            if chunk >= 0:
                left = lists.region_lengths[region]
                head = fetch_add_once(lists.counts, _NEXT_CHUNK, 1, lane)
                chain.chunk = head
                # Each group of four lanes looks at the four triangles of the leaf that seems nearest to it.
                best, best2 = nearest_box(tree, base, lists, region, cell.centre, lane, lanes)
                best = group_of_least(best2, best, lane)
                at = lane % _LEAF
                while at < _LEAF:
                    t = first_triangle(tree, best) + at
                    if t < first_triangle(tree, best + 1):
                        known = remember(known, seen_from(frames, mesh * tree.count + t, cell.centre))
                    at = at + wp.min(lanes, _LEAF)
                known = agree(known, lane)
            ripe = int(0)
            at = int(0)
            while (left > 0 or ripe > 0) and chain.chunk < lists.chunks:
                # Leaves are taken until their triangles fill all lanes.
                if left > 0 and ripe * _LEAF < lanes:
                    leaf = int(-1)
                    if at + lane < wp.min(left, _ROOM):
                        leaf = lists.pool[chunk * _CHUNK + at + lane]
                    keep = False
                    if leaf >= 0:
                        keep = node_matters(cell, known, tree, base + leaves + leaf)
                    mask = ballot(keep)
                    if keep:
                        stacks[stack + ripe + rank(mask, lane)] = leaf
                    ripe = ripe + members(mask)
                    at = at + lanes
                    if at >= wp.min(left, _ROOM):
                        left = left - wp.min(left, _ROOM)
                        at = int(0)
                        if left > 0:
                            chunk = lists.pool[chunk * _CHUNK + _ROOM]
                else:
                    taken = wp.min(wp.max(lanes / _LEAF, 1), ripe)
                    ripe = ripe - taken
                    mine = known
                    i = lane
                    while i - lane < taken * _LEAF:
                        keep = False
                        slot = int(0)
                        if i < taken * _LEAF:
                            leaf = stacks[stack + ripe + i / _LEAF]
                            t = first_triangle(tree, leaf) + i % _LEAF
                            if t < first_triangle(tree, leaf + 1):
                                slot = mesh * tree.count + t
                                # Lanes that skip a triangle wait for those that do not, so this is for a CPU.
                                if not on_cpu() or not ball_is_behind(cell, known, load4(parts.balls, slot)):
                                    f = load_frame(frames, slot)
                                    seen = see(f, cell.centre)
                                    if not triangle_is_behind(cell, known, f, seen):
                                        keep = parts_that_matter(cell, tree, parts, slot) != 0
                                    mine = remember(mine, away(f, seen))
                        chain = append(lists, chain, keep, slot, lane)
                        i = i + lanes
                    known = agree(mine, lane)
                wait_for_lanes()
            if lane == 0:
                found = chain.chunk < lists.chunks
                lists.heads[item] = wp.where(found, head, -1)
                lists.lengths[item] = chain.length
                if chain.length > longest or is_coarse(cell) or not found:
                    lists.heavy[fetch_add(lists.counts, _HEAVY, 1)] = item
        item = fetch_add_once(lists.counts, _NEXT_CELL, 1, lane)


def list_cells(
    tree: Tree,
    frames: wp.array,
    parts: Parts,
    slab: Slab,
    lists: Lists,
    longest: int,
    stacks: wp.array,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Fill the cells' lists of one pass from their regions', with `workers` groups of lanes.

    Cells with more than `longest` triangles go to `lists.heavy`; `stacks` (workers * STACK int32) is scratch.
    """
    inputs = [lanes, longest, tree, frames, parts, slab, lists, stacks]
    launch(_list_cells, workers * lanes, inputs, frames.device, smallest=1)
