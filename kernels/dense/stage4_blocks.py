"""Stage 4 of the dense query: the schedule of blocks, and the surface point that the distances of each are taken from.

A cell is a block by itself, or where it has more than 8^3 voxels its eight bricks are, with one list. If a list is long
there are several, each with a slice of it: then none is waited for. Of a cell that is too coarse for float32 the eight
bricks are blocks with lists of their own. Blocks with long lists come first, so that those that are left to the end,
when some of the device has nothing to do, are short.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, first_triangle, node_distance2, nodes_of
from sdm.kernels.culling.voronoi_features import Features
from sdm.kernels.culling.witness_bound import Witness, agree, moved, no_witness, read_witness, remember, write_witness
from sdm.kernels.dense.cell_cache import Place, brick_number, note_place, noted_place
from sdm.kernels.dense.stage1_witnesses import seen_from
from sdm.kernels.dense.workspace import (
    BLOCK,
    COARSE,
    LENGTHS,
    NEXT_CELL_TO_SCHEDULE,
    SLICED,
    WHOLE,
    Lists,
    brick_start,
    is_coarse,
    list_length,
    make_cell,
    read_entry,
    read_on,
    start_reading,
)
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.vector_loads import load4

wp.set_module_options({"enable_backward": False})

# A multiprocessor of a GPU holds so many blocks: this kernel waits for memory more than it works.
SCHEDULE_BLOCKS = 8

# A cell's number, which of its slices, how many there are less one, in one integer.
CELL_BITS, SLICE_BITS = 18, 6
_MOST_SLICES = 1 << SLICE_BITS


@wp.func
def cell_of(code: int):
    return code & ((1 << CELL_BITS) - 1)


@wp.func
def slice_of(code: int):
    return (code >> CELL_BITS) & (_MOST_SLICES - 1)


@wp.func
def slices_of(code: int):
    return 1 + (code >> (CELL_BITS + SLICE_BITS))


@wp.func
def whole_blocks(lists: Lists):
    """Number of blocks that are whole cells, or slices of their lists."""
    total = int(0)
    for length in range(LENGTHS):
        total = total + lists.counts[WHOLE + length]
    return total


@wp.func_native(
    snippet=f"""
    int length = {LENGTHS - 1};
    // Not written out several times: code that does not fit into a GPU's cache has to be waited for.
    #pragma unroll 1
    for (int here; item >= (here = counts.data[{WHOLE} + length]); --length) item -= here;
    return length * slices + item;
"""
)
def _place_of_whole(counts: wp.array(dtype=wp.int32), slices: int, item: int) -> int: ...


@wp.func
def whole_block(lists: Lists, item: int):
    """The code of one of them: those with the longest lists first."""
    return lists.whole[_place_of_whole(lists.counts, lists.slices, item)]


@wp.func
def length_class(length: int):
    """Length class of a list: the power of two that is in its length."""
    power = int(0)
    while power < LENGTHS - 1 and (length >> (power + 1)) > 0:
        power = power + 1
    return power


@wp.func
def may_be_nearer(ball: wp.vec4, centre: wp.vec3, known: Witness):
    """True if a ball reaches nearer to a centre than what is known."""
    reach = wp.length(centre - wp.vec3(ball[0], ball[1], ball[2])) - ball[3]
    return reach <= 0.0 or reach * reach < known.distance2


@wp.func
def nearest_in_list(
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    features: Features,
    lists: Lists,
    number: int,
    mesh: int,
    centre: wp.vec3,
    known: Witness,
    lane: int,
    lanes: int,
):
    """The surface point nearest to a centre, of the triangles in a cell's list or what was known."""
    boxes = nodes_of(tree, mesh) + (1 << tree.depth)
    mine = known
    reader = start_reading(lists.heads, lists.lengths, number * lists.shares, lists.shares)
    # Each batch is read while the one before is looked at.
    upcoming = read_entry(lists, reader, lane)
    while reader.left > 0:
        leaf = upcoming
        reader = read_on(lists, lists.heads, lists.lengths, reader, lanes)
        upcoming = read_entry(lists, reader, lane)
        if leaf >= 0 and node_distance2(tree, boxes + leaf, centre) < mine.distance2:
            for t in range(first_triangle(tree, leaf), first_triangle(tree, leaf + 1)):
                slot = mesh * tree.count + t
                if may_be_nearer(load4(features.balls, slot), centre, mine):
                    mine = remember(mine, seen_from(frames, slot, centre))
    return agree(mine, lane)


@wp.func
def nearest_of_cell(lists: Lists, number: int):
    """The nearest of the surface points that were found for a cell's centre."""
    known = no_witness()
    for share in range(lists.shares):
        other = read_witness(lists.nearest, number * lists.shares + share)
        if other.distance2 < known.distance2:
            known = other
    return known


@wp.func
def note_bricks(tree: Tree, slab: Slab, lists: Lists, number: int, place: Place, known: Witness, lane: int, lanes: int):
    """Note a surface point near each of a cell's bricks, seen from its centre: the cell's. And where they are."""
    o = lane
    while o < 8:
        first = brick_start(lists, place.start, o)
        brick = make_cell(tree, slab, place.mesh, first, lists.cell / 2)
        if lists.cell > BLOCK:
            note_place(lists, brick_number(lists, number, o), place.mesh, first, brick)
        if is_within(slab, first):
            near = moved(known, brick.centre - place.box.centre)
            write_witness(lists.witnesses, lists.count + brick_number(lists, number, o), near)
        o = o + lanes


@wp.func
def share_out(lists: Lists, whole: bool, number: int, length: int, slice_length: int):
    """Note a cell, `whole` or brick by brick, once for each slice of its list."""
    slices = wp.clamp((length + slice_length - 1) / slice_length, 1, _MOST_SLICES)
    if slices > 1:
        lists.sliced[fetch_add(lists.counts, SLICED, 1)] = number
        lists.lacking[number] = 0
    code = number | ((slices - 1) << (CELL_BITS + SLICE_BITS))
    if whole:
        kind = length_class(wp.min(length, slice_length))
        first = kind * lists.slices + fetch_add(lists.counts, WHOLE + kind, slices)
        for i in range(slices):
            lists.whole[first + i] = code | (i << CELL_BITS)
    else:
        first = fetch_add(lists.counts, COARSE, slices)
        for i in range(slices):
            lists.coarse[first + i] = code | (i << CELL_BITS)


@wp.kernel(launch_bounds=(128, SCHEDULE_BLOCKS))
def _schedule_blocks(
    begin: int,
    lanes: int,
    slice_length: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    features: Features,
    slab: Slab,
    lists: Lists,
):
    lane = (begin + wp.tid()) % lanes
    number = fetch_add_once(lists.counts, NEXT_CELL_TO_SCHEDULE, 1, lane)
    while number < 8 * lists.count:
        place = noted_place(lists, number)
        mesh = place.mesh
        cell = place.box
        if is_within(slab, place.start):
            length = list_length(lists.heads, lists.lengths, number * lists.shares, lists.shares)
            known = no_witness()
            if length > 0:
                known = nearest_of_cell(lists, number)
            if is_coarse(cell):
                note_bricks(tree, slab, lists, number, place, known, lane, lanes)
            else:
                if length > 0:
                    known = nearest_in_list(
                        tree, frames, features, lists, number, mesh, cell.centre, known, lane, lanes
                    )
                if lane == 0:
                    write_witness(lists.witnesses, lists.count + number, known)
                if lists.cell > BLOCK:
                    note_bricks(tree, slab, lists, number, place, known, lane, lanes)
            if lane == 0:
                share_out(lists, not is_coarse(cell), number, length, slice_length)
        number = fetch_add_once(lists.counts, NEXT_CELL_TO_SCHEDULE, 1, lane)


def schedule_blocks(
    tree: Tree,
    frames: wp.array,
    features: Features,
    slab: Slab,
    lists: Lists,
    slice_length: int,
    workers: int,
    lanes: int,
) -> None:
    """Fill `lists.whole` with the cells of one pass, and `lists.coarse` with those that are too coarse.

    One group of lanes takes up to `slice_length` leaves of a cell's list.
    """
    inputs = [lanes, slice_length, tree, frames, features, slab, lists]
    launch(_schedule_blocks, workers * lanes, inputs, frames.device, smallest=1)
