"""Fourth stage of the dense query: the distances themselves, block by block.

A block is a cell of 8^3 voxels whose list is short, or one of the eight bricks of 4^3 of a cell whose list is long.
One group of lanes takes one block. It filters the cell's list once more, for the block, lists the parts of the
triangles that are left, and measures the block's voxels from those.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cones import Cones, ball_matters
from sdm.kernels.cull import Witness, moved
from sdm.kernels.features import Counts, Features, add_features, has_room, rows_of
from sdm.kernels.grid import Output, Slab, index_of
from sdm.kernels.lanes import GPU_BLOCKS, ballot, fetch_add, fetch_add_once, members, rank, wait_for_lanes
from sdm.kernels.lists import (
    BRICK,
    CELL,
    HEAVY,
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
from sdm.kernels.parts import Parts, parts_that_matter
from sdm.kernels.plan import brick_witness, cell_of, middle_of_octant, slice_of, slices_of
from sdm.kernels.regions import STACK
from sdm.kernels.tree import FRAME_SIZE, SCALE, UNSCALE, Tree
from sdm.kernels.voxels import LARGEST_SQUARE, Block, measure_voxels, note_places
from sdm.kernels.witness import read_witness

wp.set_module_options({"enable_backward": False})

_STACK = wp.constant(STACK)
_HEAVY, _WHOLE = wp.constant(HEAVY), wp.constant(WHOLE)
_NEXT_BLOCK = wp.constant(NEXT_BLOCK)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
_UNSCALE = wp.constant(UNSCALE)


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
    radius = wp.sqrt(block.cell.half2)
    reader = Reader()
    if list_length(lists.heads, lists.lengths, first, lists.shares) > 0 and not is_coarse(block.cell):
        if known.distance2 < LARGEST_SQUARE:
            reader = start_reading(lists.heads, lists.lengths, first, lists.shares)
    block.radius2 = known.distance2
    rows = rows_of(features.rows, worker)
    note_places(tree, slab, rows, block, lane, lanes)
    wait_for_lanes()
    counts = Counts()
    unclear = int(0)
    again = bool(False)
    stack = worker * _STACK
    ripe = int(0)
    # Each batch is read while the one before is tested.
    upcoming = read_entry(lists, reader, lane)
    batch = int(0)
    more = bool(True)
    while more:
        if reader.left > 0 and ripe < lanes:
            # Balls and cones, until the triangles that are left fill all lanes.
            slot = upcoming
            reader = read_on(lists, lists.heads, lists.lengths, reader, lanes)
            upcoming = read_entry(lists, reader, lane)
            keep = False
            if slot >= 0 and batch % block.slices == block.slice:
                keep = ball_matters(block.cell, radius, known, parts.balls, cones, slot)
            mask = ballot(keep)
            if keep:
                stacks[stack + ripe + rank(mask, lane)] = slot
            ripe = ripe + members(mask)
            batch = batch + 1
        else:
            taken = wp.min(lanes, ripe)
            which = int(0)
            slot = int(0)
            if lane < taken:
                slot = stacks[stack + ripe - taken + lane]
                which = parts_that_matter(block.cell, tree, parts, slot)
            fits = has_room(counts, which)
            if fits:
                counts = add_features(rows, counts, tree, parts, slot, which, block.cell.centre, block.radius2, lane)
                ripe = ripe - taken
            more = reader.left + ripe > 0
            if not (fits and more):
                wait_for_lanes()
                unclear = unclear + measure_voxels(
                    tree, slab, out, features, worker, rows, counts, block, again, not more, lane, lanes
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
    bricks = 8 * lists.counts[_HEAVY]
    total = bricks + lists.counts[_WHOLE]
    item = fetch_add_once(lists.counts, _NEXT_BLOCK, 1, lane)
    while item < total:
        # The bricks first: they take longer.
        block = Block()
        number = int(0)
        witness = int(0)
        if item < bricks:
            code = lists.heavy[item / 8]
            number = cell_of(code)
            block.bits = 2
            block.slice = slice_of(code)
            block.slices = slices_of(code)
            witness = brick_witness(lists, number, item % 8)
        else:
            number = lists.whole[item - bricks]
            block.bits = 3
            block.slices = 1
            witness = lists.count + number
        mesh, start = cell_start(lists, number)
        scale = float(tree.frame[mesh * _FRAME_SIZE + _SCALE])
        cell = make_cell(slab, start, CELL, scale)
        known = read_witness(lists.witnesses, witness)
        block.mesh = mesh
        block.start = start
        block.cell = cell
        if item < bricks:
            block.start = start + BRICK * octant_at(item)
            block.cell = make_cell(slab, block.start, BRICK, scale)
            known = moved(known, block.cell.centre - middle_of_octant(cell, item % 8))
        block.index = index_of(slab, mesh, block.start)
        block.unscale = float(tree.frame[mesh * _FRAME_SIZE + _UNSCALE])
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
