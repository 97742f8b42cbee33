"""Fifth stage of the dense query: the distances themselves, block by block.

One group of lanes takes one block, or a slice of its list of parts. It works the parts out for the block's centre, and
measures each octant's voxels from those that matter to it.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.atomics import fetch_add, fetch_add_once
from sdm.kernels.features import Counts, add_corner, add_edge, add_face, has_room
from sdm.kernels.grid import Output, Slab, index_of
from sdm.kernels.lanes import GPU_BLOCKS, wait_for_lanes
from sdm.kernels.least import VOXELS
from sdm.kernels.leaves import push
from sdm.kernels.lists import (
    COARSE,
    NEXT_BLOCK,
    NEXT_SLICED,
    SLICED,
    Lists,
    Reader,
    cell_start,
    is_within,
    read_entry,
    read_on,
    start_reading,
)
from sdm.kernels.octants import octants_of
from sdm.kernels.parts import Parts
from sdm.kernels.plan import whole_blocks
from sdm.kernels.rows import rows_of
from sdm.kernels.selection import block_of
from sdm.kernels.stacks import small_stack_of
from sdm.kernels.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.voxels import Block, Features, index_in, measure_voxels, note_places

wp.set_module_options({"enable_backward": False})

# Where a worker's stacks begin: of faces, edges and corners that wait, at most 64 each.
FACES, EDGES, CORNERS = 0, 64, 128

_FACES, _EDGES, _CORNERS = wp.constant(FACES), wp.constant(EDGES), wp.constant(CORNERS)
_COARSE, _SLICED = wp.constant(COARSE), wp.constant(SLICED)
_NEXT_BLOCK, _NEXT_SLICED = wp.constant(NEXT_BLOCK), wp.constant(NEXT_SLICED)
_VOXELS = wp.constant(VOXELS)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)


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
    slab: Slab,
    lists: Lists,
    item: int,
    features: Features,
    stacks: wp.array(dtype=wp.int32),
    worker: int,
    out: Output,
    block: Block,
    lane: int,
    lanes: int,
):
    """Measure block `item` from its parts; without a list, every voxel is missed."""
    rows = rows_of(features.rows, worker)
    note_places(tree, slab, rows, block, lane, lanes)
    scale = tree.frame[block.mesh * _FRAME_SIZE + _SCALE]
    octants = octants_of(slab, block.start, block.bits, block.cell, scale)
    wait_for_lanes()
    reader = Reader()
    if lists.part_heads[item] >= 0:
        reader = start_reading(lists.part_heads, lists.part_lengths, item, 1)
    # Each batch is read while the one before is worked out.
    upcoming = read_entry(lists, reader, lane)
    counts = Counts()
    waiting = Counts()
    unclear = int(0)
    again = bool(False)
    stack = small_stack_of(stacks, worker)
    more = bool(True)
    while more:
        full = waiting.faces >= lanes or waiting.edges >= lanes or waiting.corners >= lanes
        if reader.left > 0 and not full:
            part = upcoming
            reader = read_on(lists, lists.part_heads, lists.part_lengths, reader, lanes)
            upcoming = read_entry(lists, reader, lane)
            kind = part & 7
            code = 4 * (part >> 3)
            corner = part >= 0 and kind < 3
            edge = part >= 0 and kind >= 3 and kind < 6
            face = part >= 0 and kind == 6
            waiting.faces = waiting.faces + push(stack, _FACES + waiting.faces, face, code, lane)
            waiting.edges = waiting.edges + push(stack, _EDGES + waiting.edges, edge, code + kind - 3, lane)
            waiting.corners = waiting.corners + push(stack, _CORNERS + waiting.corners, corner, code + kind, lane)
        else:
            # The parts that fill all lanes, or all that are left.
            last = reader.left == 0
            faces = ready(waiting.faces, last, lanes)
            edges = ready(waiting.edges, last, lanes)
            corners = ready(waiting.corners, last, lanes)
            fits = has_room(counts, faces, edges, corners)
            if fits:
                waiting.faces = waiting.faces - faces
                waiting.edges = waiting.edges - edges
                waiting.corners = waiting.corners - corners
                if lane < faces:
                    code = stack[_FACES + waiting.faces + lane]
                    add_face(rows, counts.faces + lane, tree, parts, code, block.cell, block.radius2, octants)
                if lane < edges:
                    code = stack[_EDGES + waiting.edges + lane]
                    add_edge(rows, counts.edges + lane, tree, parts, code, block.cell, block.radius2, octants)
                if lane < corners:
                    code = stack[_CORNERS + waiting.corners + lane]
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


@wp.kernel(launch_bounds=(128, GPU_BLOCKS))
def _measure_blocks(
    begin: int,
    lanes: int,
    tree: Tree,
    parts: Parts,
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
    total = bricks + whole_blocks(lists)
    item = fetch_add_once(lists.counts, _NEXT_BLOCK, 1, lane)
    while item < total:
        block, _number, known = block_of(tree, slab, lists, item, bricks)
        block.radius2 = known.distance2
        if is_within(slab, block.start):
            measure_block(tree, parts, slab, lists, item, features, stacks, worker, out, block, lane, lanes)
        item = fetch_add_once(lists.counts, _NEXT_BLOCK, 1, lane)


@wp.kernel
def _count_missed(begin: int, lanes: int, slab: Slab, lists: Lists, out: Output):
    lane = (begin + wp.tid()) % lanes
    item = fetch_add_once(lists.counts, _NEXT_SLICED, 1, lane)
    while item < lists.counts[_SLICED]:
        mesh, start = cell_start(lists, lists.sliced[item])
        v = lane
        while v < _VOXELS:
            at = start + index_in(v)
            if is_within(slab, at):
                if not wp.abs(out.values[index_of(slab, mesh, at)]) < float(wp.inf):
                    fetch_add(out.missed, 0, 1)
            v = v + lanes
        item = fetch_add_once(lists.counts, _NEXT_SLICED, 1, lane)


def measure_blocks(
    tree: Tree,
    parts: Parts,
    slab: Slab,
    lists: Lists,
    features: Features,
    stacks: wp.array,
    out: Output,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Distances of every voxel of one pass, block by block, with `workers` groups of lanes.

    `features` and `stacks` are scratch. Voxels of blocks whose list found no room become infinite with their sign, and
    are counted in `out.missed`.
    """
    inputs = [lanes, tree, parts, slab, lists, features, stacks, out]
    launch(_measure_blocks, workers * lanes, inputs, out.values.device, smallest=1)
    # Whether voxels that several slices measure are missed nobody knows before the last is done.
    launch(_count_missed, workers * lanes, [lanes, slab, lists, out], out.values.device, smallest=1)
