"""Second stage of the dense query: for each cell of 8^3 voxels, the triangles that matter to it.

One group of lanes takes one cell, or one share of its region's list. It tests the leaves of that list, then the balls
and cones of their triangles, then the parts of those that are left. Each test costs several times the one before, so
what passes waits until it fills all lanes.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cones import Cones, ball_matters
from sdm.kernels.cull import agree, away, remember, triangle_is_behind
from sdm.kernels.frames import load_frame, see
from sdm.kernels.grid import Slab
from sdm.kernels.lanes import GPU_BLOCKS, ballot, fetch_add_once, members, rank, wait_for_lanes
from sdm.kernels.lists import (
    CELL,
    NEXT_CELL,
    NEXT_CHUNK,
    Chain,
    Lists,
    Reader,
    append,
    cell_start,
    is_within,
    make_cell,
    read_entry,
    read_on,
    start_reading,
)
from sdm.kernels.parts import Parts, parts_that_matter
from sdm.kernels.regions import STACK, node_matters
from sdm.kernels.tree import FRAME_SIZE, SCALE, TRIANGLES_PER_LEAF, Tree, first_triangle
from sdm.kernels.witness import read_witness, write_witness

wp.set_module_options({"enable_backward": False})

_STACK = wp.constant(STACK)
_NEXT_CELL = wp.constant(NEXT_CELL)
_NEXT_CHUNK = wp.constant(NEXT_CHUNK)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
_LEAF = wp.constant(TRIANGLES_PER_LEAF)


@wp.kernel(launch_bounds=(128, GPU_BLOCKS))
def _list_cells(
    begin: int,
    lanes: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    parts: Parts,
    cones: Cones,
    slab: Slab,
    lists: Lists,
    stacks: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = (thread / lanes) * _STACK
    slots = stack + _STACK / 2
    leaves = 1 << tree.depth
    item = fetch_add_once(lists.counts, _NEXT_CELL, 1, lane)
    while item < 8 * lists.count * lists.shares:
        number = item / lists.shares
        mesh, start = cell_start(lists, number)
        share = (number / 8) * lists.shares + item % lists.shares
        if is_within(slab, start):
            base = mesh * 2 * leaves
            cell = make_cell(slab, start, CELL, float(tree.frame[mesh * _FRAME_SIZE + _SCALE]))
            radius = wp.sqrt(cell.half2)
            known = read_witness(lists.witnesses, lists.count + number)
            chain = Chain()
            chain.chunk = lists.chunks
            head = int(-1)
            reader = Reader()
            if lists.region_heads[share] >= 0:
                reader = start_reading(lists.region_heads, lists.region_lengths, share, 1)
                head = fetch_add_once(lists.counts, _NEXT_CHUNK, 1, lane)
                chain.chunk = head
            # Each batch is read while the one before is tested.
            upcoming = read_entry(lists, reader, lane)
            waiting = int(0)
            ripe = int(0)
            while reader.left + waiting + ripe > 0 and chain.chunk < lists.chunks:
                if ripe >= lanes or reader.left + waiting == 0:
                    # Triangles that fill all lanes: their parts.
                    taken = wp.min(lanes, ripe)
                    ripe = ripe - taken
                    keep = False
                    slot = int(0)
                    mine = known
                    if lane < taken:
                        slot = stacks[slots + ripe + lane]
                        if parts_that_matter(cell, tree, parts, slot) != 0:
                            f = load_frame(frames, slot)
                            seen = see(f, cell.centre)
                            keep = not triangle_is_behind(cell, known, f, seen)
                            mine = remember(mine, away(f, seen))
                    known = agree(mine, lane)
                    chain = append(lists, chain, keep, slot, lane)
                elif waiting * _LEAF >= lanes or reader.left == 0:
                    # Leaves whose triangles fill all lanes: their balls and cones.
                    taken = wp.min(wp.max(lanes / _LEAF, 1), waiting)
                    waiting = waiting - taken
                    i = lane
                    while i - lane < taken * _LEAF:
                        keep = False
                        slot = int(0)
                        if i < taken * _LEAF:
                            leaf = stacks[stack + waiting + i / _LEAF]
                            t = first_triangle(tree, leaf) + i % _LEAF
                            if t < first_triangle(tree, leaf + 1):
                                slot = mesh * tree.count + t
                                keep = ball_matters(cell, radius, known, parts.balls, cones, slot)
                        mask = ballot(keep)
                        if keep:
                            stacks[slots + ripe + rank(mask, lane)] = slot
                        ripe = ripe + members(mask)
                        i = i + lanes
                else:
                    leaf = upcoming
                    reader = read_on(lists, lists.region_heads, lists.region_lengths, reader, lanes)
                    upcoming = read_entry(lists, reader, lane)
                    keep = False
                    if leaf >= 0:
                        keep = node_matters(cell, radius, known, tree, cones, base, leaves + leaf)
                    mask = ballot(keep)
                    if keep:
                        stacks[stack + waiting + rank(mask, lane)] = leaf
                    waiting = waiting + members(mask)
                wait_for_lanes()
            if lane == 0:
                # The nearest triangle passes every test, so what is known now is the nearest of this share.
                write_witness(lists.nearest, item, known)
                lists.heads[item] = wp.where(chain.chunk < lists.chunks, head, -1)
                lists.lengths[item] = chain.length
        item = fetch_add_once(lists.counts, _NEXT_CELL, 1, lane)


def list_cells(
    tree: Tree,
    frames: wp.array,
    parts: Parts,
    cones: Cones,
    slab: Slab,
    lists: Lists,
    stacks: wp.array,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Fill the cells' lists and `nearest` of one pass from their regions' lists, with `workers` groups of lanes.

    `stacks` (workers * STACK int32) is scratch.
    """
    inputs = [lanes, tree, frames, parts, cones, slab, lists, stacks]
    launch(_list_cells, workers * lanes, inputs, frames.device, smallest=1)
