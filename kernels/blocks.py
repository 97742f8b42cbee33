"""Fourth stage of the dense query: the distances themselves, block by block.

A block is a cell of 8^3 voxels, or a brick of 4^3 of one that is coarse. One group of lanes takes one block, or a slice of
its list. It goes from the leaves of the list to their triangles, from those that may be nearest to the parts of them that
may be, works these out for the block's centre, and measures each octant's voxels from those that matter to it. Each test
costs several times the one before, so what passes waits until it fills all lanes.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cones import Cones
from sdm.kernels.cull import Witness, moved
from sdm.kernels.features import Counts, add_corner, add_edge, add_face, has_room
from sdm.kernels.grid import Output, Slab, index_of
from sdm.kernels.lanes import GPU_BLOCKS, fetch_add, fetch_add_once, wait_for_lanes
from sdm.kernels.leaves import (
    CORNERS,
    EDGES,
    FACES,
    LEAVES,
    SLOTS,
    Waiting,
    full_of_leaves,
    push,
    push_parts,
    triangles_that_matter,
)
from sdm.kernels.lists import (
    BRICK,
    CELL,
    COARSE,
    NEXT_BLOCK,
    WHOLE,
    Lists,
    Reader,
    cell_start,
    is_coarse,
    is_within,
    list_length,
    make_cell,
    octant_at,
    read_entry,
    read_on,
    start_reading,
)
from sdm.kernels.octants import note_octants
from sdm.kernels.parts import Parts, parts_that_matter
from sdm.kernels.plan import brick_witness, cell_of, middle_of_octant, slice_of, slices_of
from sdm.kernels.regions import STACK, node_matters
from sdm.kernels.rows import rows_of
from sdm.kernels.tree import FRAME_SIZE, SCALE, UNSCALE, Tree
from sdm.kernels.voxels import LARGEST_SQUARE, Block, Features, measure_voxels, note_places
from sdm.kernels.witness import read_witness

wp.set_module_options({"enable_backward": False})

_STACK = wp.constant(STACK)
_LEAVES, _SLOTS = wp.constant(LEAVES), wp.constant(SLOTS)
_FACES, _EDGES, _CORNERS = wp.constant(FACES), wp.constant(EDGES), wp.constant(CORNERS)
_COARSE, _WHOLE = wp.constant(COARSE), wp.constant(WHOLE)
_NEXT_BLOCK = wp.constant(NEXT_BLOCK)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
_UNSCALE = wp.constant(UNSCALE)


@wp.func
def ready(waiting: int, last: bool, lanes: int):
    """How many of the parts that wait are to be taken now."""
    if waiting >= lanes or last:
        return wp.min(waiting, lanes)
    return 0


@wp.func
def measure_block(
    tree: Tree,
    parts: Parts,
    cones: Cones,
    slab: Slab,
    lists: Lists,
    item: int,
    features: Features,
    stacks: wp.array(dtype=wp.int32),
    worker: int,
    out: Output,
    block: Block,
    known: Witness,
    lane: int,
    lanes: int,
):
    """Measure a block of the cell `item`; `known` is a surface point seen from its centre."""
    first = item * lists.shares
    leaves = 1 << tree.depth
    radius = wp.sqrt(block.cell.half2)
    reader = Reader()
    if list_length(lists.heads, lists.lengths, first, lists.shares) > 0 and not is_coarse(block.cell):
        if known.distance2 < LARGEST_SQUARE:
            reader = start_reading(lists.heads, lists.lengths, first, lists.shares)
    block.radius2 = known.distance2
    rows = rows_of(features.rows, worker)
    note_places(tree, slab, rows, block, lane, lanes)
    scale = tree.frame[block.mesh * _FRAME_SIZE + _SCALE]
    octants = note_octants(slab, rows, block.start, block.bits, block.cell, scale, lane, lanes)
    wait_for_lanes()
    counts = Counts()
    waiting = Waiting()
    unclear = int(0)
    again = bool(False)
    stack = worker * _STACK
    # Each batch is read while the one before is tested.
    upcoming = read_entry(lists, reader, lane)
    batch = int(0)
    more = bool(True)
    while more:
        full = waiting.faces >= lanes or waiting.edges >= lanes or waiting.corners >= lanes
        if not full and waiting.slots < lanes and reader.left > 0 and waiting.leaves < full_of_leaves(lanes):
            leaf = upcoming
            reader = read_on(lists, lists.heads, lists.lengths, reader, lanes)
            upcoming = read_entry(lists, reader, lane)
            keep = leaf >= 0 and batch % block.slices == block.slice
            if keep and block.bits == 2:
                # For the cell it has been tested.
                keep = node_matters(block.cell, radius, known, tree, cones, block.mesh * 2 * leaves, leaves + leaf)
            waiting.leaves = waiting.leaves + push(stacks, stack + _LEAVES + waiting.leaves, keep, leaf, lane)
            batch = batch + 1
        elif not full and waiting.slots < lanes and waiting.leaves > 0:
            taken = wp.min(full_of_leaves(lanes), waiting.leaves)
            waiting.leaves = waiting.leaves - taken
            waiting.slots = waiting.slots + triangles_that_matter(
                block.cell,
                radius,
                known,
                tree,
                parts.balls,
                cones,
                block.mesh,
                stacks,
                stack + _LEAVES + waiting.leaves,
                taken,
                stack + _SLOTS + waiting.slots,
                lane,
                lanes,
            )
        elif not full and waiting.slots > 0:
            taken = wp.min(lanes, waiting.slots)
            waiting.slots = waiting.slots - taken
            which = int(0)
            slot = int(0)
            if lane < taken:
                slot = stacks[stack + _SLOTS + waiting.slots + lane]
                which = parts_that_matter(block.cell, tree, parts, slot)
            waiting = push_parts(stacks, stack, waiting, slot, which, lane)
        else:
            # The parts that fill all lanes, or all that are left.
            last = reader.left + waiting.leaves + waiting.slots == 0
            faces = ready(waiting.faces, last, lanes)
            edges = ready(waiting.edges, last, lanes)
            corners = ready(waiting.corners, last, lanes)
            fits = has_room(counts, faces, edges, corners)
            if fits:
                waiting.faces = waiting.faces - faces
                waiting.edges = waiting.edges - edges
                waiting.corners = waiting.corners - corners
                if lane < faces:
                    code = stacks[stack + _FACES + waiting.faces + lane]
                    add_face(rows, counts.faces + lane, tree, parts, code, block.cell, block.radius2, octants)
                if lane < edges:
                    code = stacks[stack + _EDGES + waiting.edges + lane]
                    add_edge(rows, counts.edges + lane, tree, parts, code, block.cell, block.radius2, octants)
                if lane < corners:
                    code = stacks[stack + _CORNERS + waiting.corners + lane]
                    add_corner(rows, counts.corners + lane, tree, parts, code, block.cell, block.radius2, octants)
                counts.faces = counts.faces + faces
                counts.edges = counts.edges + edges
                counts.corners = counts.corners + corners
                more = not (last and waiting.faces + waiting.edges + waiting.corners == 0)
            if not (fits and more):
                wait_for_lanes()
                unclear = unclear + measure_voxels(
                    tree, slab, out, features, worker, rows, counts, octants, block, again, not more, lane, lanes
                )
                counts = Counts()
                again = True
        wait_for_lanes()
    if unclear > 0:
        fetch_add(out.ambiguous, block.mesh, unclear)


@wp.func
def block_of(tree: Tree, slab: Slab, lists: Lists, item: int, bricks: int):
    """Block `item`, of which the first `bricks` are bricks of coarse cells: also its cell's number, and a surface point
    seen from its centre."""
    code = int(0)
    if item < bricks:
        code = lists.coarse[item / 8]
    else:
        code = lists.whole[item - bricks]
    number = cell_of(code)
    mesh, start = cell_start(lists, number)
    scale = float(tree.frame[mesh * _FRAME_SIZE + _SCALE])
    block = Block()
    block.mesh = mesh
    block.start = start
    block.bits = 3
    block.slice = slice_of(code)
    block.slices = slices_of(code)
    block.unscale = float(tree.frame[mesh * _FRAME_SIZE + _UNSCALE])
    block.cell = make_cell(slab, start, CELL, scale)
    known = Witness()
    if item < bricks:
        middle = middle_of_octant(block.cell, item % 8)
        block.bits = 2
        block.start = start + BRICK * octant_at(item)
        block.cell = make_cell(slab, block.start, BRICK, scale)
        known = moved(read_witness(lists.witnesses, brick_witness(lists, number, item % 8)), block.cell.centre - middle)
    else:
        known = read_witness(lists.witnesses, lists.count + number)
    block.index = index_of(slab, mesh, block.start)
    return block, number, known


@wp.kernel(launch_bounds=(128, GPU_BLOCKS))
def _measure_blocks(
    begin: int,
    lanes: int,
    tree: Tree,
    parts: Parts,
    cones: Cones,
    slab: Slab,
    lists: Lists,
    features: Features,
    stacks: wp.array(dtype=wp.int32),
    out: Output,
):
    thread = begin + wp.tid()
    lane = thread % lanes
    worker = thread / lanes
    bricks = 8 * lists.counts[_COARSE]
    total = bricks + lists.counts[_WHOLE]
    item = fetch_add_once(lists.counts, _NEXT_BLOCK, 1, lane)
    while item < total:
        block, number, known = block_of(tree, slab, lists, item, bricks)
        if is_within(slab, block.start):
            measure_block(
                tree,
                parts,
                cones,
                slab,
                lists,
                number,
                features,
                stacks,
                worker,
                out,
                block,
                known,
                lane,
                lanes,
            )
        item = fetch_add_once(lists.counts, _NEXT_BLOCK, 1, lane)


def measure_blocks(
    tree: Tree,
    parts: Parts,
    cones: Cones,
    slab: Slab,
    lists: Lists,
    features: Features,
    stacks: wp.array,
    out: Output,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Distances of every voxel of one pass, of the cells and bricks that were planned.

    `features` and `stacks` are scratch. Voxels of cells whose list found no room become infinite with their sign, and
    are counted in `out.missed`.
    """
    inputs = [lanes, tree, parts, cones, slab, lists, features, stacks, out]
    launch(_measure_blocks, workers * lanes, inputs, out.values.device, smallest=1)
