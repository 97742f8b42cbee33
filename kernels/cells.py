"""Second stage of the dense query: for each cell of voxels, the leaves of the tree that matter to it.

One group of lanes takes a few cells of one region, or one share of its list: reading the boxes of the leaves, which lie
apart, takes a GPU as long as comparing them with four cells. Triangles are not looked at here: where they are many,
each would be tested for every cell, and a leaf's box and cone tell nearly as much about its four.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.abreast import note_box, note_state, noted_box, noted_state, notes_of
from sdm.kernels.atomics import fetch_add_once
from sdm.kernels.cones import Cones, node_cone
from sdm.kernels.grid import Slab
from sdm.kernels.lanes import wait_for_lanes
from sdm.kernels.lists import (
    NEXT_CELL,
    Chain,
    Lists,
    Reader,
    append,
    is_within,
    list_length,
    read_entry,
    read_on,
    start_reading,
)
from sdm.kernels.places import noted_place, noted_start
from sdm.kernels.regions import box_matters
from sdm.kernels.rough import about_root
from sdm.kernels.tree import Tree, node_box
from sdm.kernels.witness import nearer_of_leaves, read_witness, write_witness

wp.set_module_options({"enable_backward": False})

# A multiprocessor of a GPU holds so many blocks: this kernel waits for memory more than it works.
CELL_BLOCKS = 5

_NEXT_CELL = wp.constant(NEXT_CELL)


@wp.func
def note_cells(slab: Slab, lists: Lists, notes: wp.uint64, number: int, share: int, there: bool, lane: int, lanes: int):
    """Note the `lists.abreast` cells from `number` on, with empty chains, or with none where there is no list to read.

    Cells beyond the slab have none either.
    """
    i = lane
    while i < lists.abreast:
        place = noted_place(lists, number + i)
        chain = Chain()
        chain.chunk = lists.chunks
        if there and is_within(slab, place.start):
            chain.chunk = lists.count * lists.region_shares + (number + i) * lists.shares + share
        note_box(notes, i, place.cell)
        note_state(notes, i, read_witness(lists.witnesses, lists.count + number + i), chain)
        i = i + lanes


@wp.func
def keep_lists(slab: Slab, lists: Lists, notes: wp.uint64, number: int, share: int, lane: int, lanes: int):
    """Write what was found for these cells to where the next stage looks for it."""
    i = lane
    while i < lists.abreast:
        _mesh, start = noted_start(lists, number + i)
        if is_within(slab, start):
            known, chain = noted_state(notes, i)
            item = (number + i) * lists.shares + share
            write_witness(lists.nearest, item, known)
            head = lists.count * lists.region_shares + item
            lists.heads[item] = wp.where(chain.chunk < lists.chunks, head, -1)
            lists.lengths[item] = chain.length
        i = i + lanes


@wp.kernel(launch_bounds=(128, CELL_BLOCKS))
def _list_cells(
    begin: int,
    lanes: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    cones: Cones,
    slab: Slab,
    lists: Lists,
    stacks: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    leaves = 1 << tree.depth
    notes = notes_of(stacks, thread / lanes)
    item = fetch_add_once(lists.counts, _NEXT_CELL, 1, lane)
    while item < 8 * lists.count * lists.shares / lists.abreast:
        number = item / lists.shares * lists.abreast
        share = item % lists.shares
        # The chains of its region that are this share's.
        chains = lists.region_shares / lists.shares
        first = (number / 8) * lists.region_shares + share * chains
        there = list_length(lists.region_heads, lists.region_lengths, first, chains) >= 0
        note_cells(slab, lists, notes, number, share, there, lane, lanes)
        wait_for_lanes()
        mesh, _start = noted_start(lists, number)
        base = mesh * 2 * leaves
        reader = Reader()
        if there:
            reader = start_reading(lists.region_heads, lists.region_lengths, first, chains)
        # Each batch is read while the one before is tested.
        upcoming = read_entry(lists, reader, lane)
        while reader.left > 0:
            leaf = upcoming
            reader = read_on(lists, lists.region_heads, lists.region_lengths, reader, lanes)
            upcoming = read_entry(lists, reader, lane)
            # Read once, for all that follows.
            low = wp.vec3()
            high = wp.vec3()
            cone = wp.vec4()
            if leaf >= 0:
                low, high = node_box(tree, base + leaves + leaf)
                cone = node_cone(tree, cones, base, leaves + leaf)
            for i in range(lists.abreast):
                known, chain = noted_state(notes, i)
                if chain.chunk < lists.chunks:
                    cell = noted_box(notes, i)
                    known = nearer_of_leaves(tree, frames, mesh, leaf, low, high, cell.centre, known, lane)
                    keep = False
                    if leaf >= 0:
                        keep = box_matters(cell, about_root(cell.half2), known, low, high, cone)
                    chain = append(lists, chain, keep, leaf, lane)
                    wait_for_lanes()
                    if lane == 0:
                        note_state(notes, i, known, chain)
            wait_for_lanes()
        keep_lists(slab, lists, notes, number, share, lane, lanes)
        wait_for_lanes()
        item = fetch_add_once(lists.counts, _NEXT_CELL, 1, lane)


def list_cells(
    tree: Tree,
    frames: wp.array,
    cones: Cones,
    slab: Slab,
    lists: Lists,
    stacks: wp.array,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Fill the cells' lists and `nearest` of one pass from their regions' lists, with `workers` groups of lanes.

    `stacks` is scratch, see `stacks`.
    """
    launch(_list_cells, workers * lanes, [lanes, tree, frames, cones, slab, lists, stacks], frames.device, smallest=1)
