"""Fourth stage of the dense query: the distances themselves, block by block.

A block is a cell of 8^3 voxels whose list is short, or one of the eight bricks of 4^3 of a cell whose list is long.
One group of lanes takes one block. It filters the cell's list once more, for the block, lists the parts of the
triangles that are left, and measures the block's voxels from those.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cones import Cones, ball_matters
from sdm.kernels.cull import Cell, Witness, moved, remember
from sdm.kernels.features import (
    NEAR_ENDS,
    VOXELS,
    Counts,
    Features,
    add_features,
    has_room,
    is_near,
    least_distance,
    least_values,
    lessen_values,
    read_place,
    rows_of,
    write_place,
)
from sdm.kernels.grid import Output, Slab, along, index_of, voxel, write_distance
from sdm.kernels.lanes import (
    GPU_BLOCKS,
    ballot,
    fetch_add,
    fetch_add_once,
    load4,
    members,
    on_cpu,
    rank,
    shrink,
    wait_for_lanes,
)
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
from sdm.kernels.witness import read_witness, seen_from

wp.set_module_options({"enable_backward": False})

# Squares beyond this one may overflow.
LARGEST_SQUARE = wp.constant(1.0e36)

_STACK = wp.constant(STACK)
_VOXELS = wp.constant(VOXELS)
_HEAVY, _WHOLE = wp.constant(HEAVY), wp.constant(WHOLE)
_NEXT_BLOCK = wp.constant(NEXT_BLOCK)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
_UNSCALE = wp.constant(UNSCALE)


@wp.struct
class Block:
    """Up to 8^3 or 4^3 voxels of a mesh's map."""

    mesh: wp.int32
    start: wp.vec3i  # its first voxel
    bits: wp.int32  # 3 or 2: the voxels along each edge are 2^bits
    slice: wp.int32  # which part of its cell's list counts: every `slices`-th batch of the lanes' entries
    slices: wp.int32
    index: wp.int32  # of its first voxel, see `index_of`
    unscale: float  # from scaled distances to the mesh's unit
    cell: Cell
    radius2: float  # squared distance of its centre from the surface


@wp.func
def may_be_nearer(ball: wp.vec4, centre: wp.vec3, known: Witness):
    """Whether a ball reaches nearer to a centre than what is known."""
    reach = wp.length(centre - wp.vec3(ball[0], ball[1], ball[2])) - ball[3]
    return reach <= 0.0 or reach * reach < known.distance2


@wp.func
def nearest_in_list(
    frames: wp.array(dtype=wp.float32), parts: Parts, lists: Lists, first: int, centre: wp.vec3, known: Witness
):
    """The surface point nearest to a block's centre from its cell's list, or what was known: by one lane alone."""
    reader = start_reading(lists.heads, lists.lengths, first, lists.shares)
    while reader.left > 0:
        slot = read_entry(lists, reader, 0)
        if may_be_nearer(load4(parts.balls, slot), centre, known):
            known = remember(known, seen_from(frames, slot, centre))
        reader = read_on(lists, lists.heads, lists.lengths, reader, 1)
    return known


@wp.func
def index_in(block: Block, v: int):
    """Voxel v of a block: its indices from the block's first."""
    mask = (1 << block.bits) - 1
    return wp.vec3i(v >> (2 * block.bits), (v >> block.bits) & mask, v & mask)


@wp.func
def note_places(tree: Tree, slab: Slab, rows: wp.uint64, block: Block, lane: int, lanes: int):
    """Note the voxels' coordinates along each axis, from the block's centre; a turned grid's are not so simple."""
    scale = tree.frame[block.mesh * _FRAME_SIZE + _SCALE]
    at = lane
    while at < 8:
        for axis in range(3):
            p = scale * wp.float64(along(slab, axis, block.start[axis] + at))
            write_place(rows, 8 * axis + at, float(p - wp.float64(block.cell.centre[axis])))
        at = at + lanes


@wp.func
def local_voxel(tree: Tree, slab: Slab, rows: wp.uint64, block: Block, v: int):
    """Voxel v of a block, from the block's centre."""
    at = index_in(block, v)
    if slab.turned != 0:
        scale = tree.frame[block.mesh * _FRAME_SIZE + _SCALE]
        p = voxel(slab, block.start[0] + at[0], block.start[1] + at[1], block.start[2] + at[2])
        return wp.vec3(scale * wp.vec3d(p) - wp.vec3d(block.cell.centre))
    return wp.vec3(read_place(rows, at[0]), read_place(rows, 8 + at[1]), read_place(rows, 16 + at[2]))


@wp.func
def finish_voxel(slab: Slab, out: Output, block: Block, v: int, p: wp.vec3, least: float):
    """Write the distance of a voxel; 1 if its winding number is unclear."""
    at = index_in(block, v)
    if not is_within(slab, block.start + at):
        return 0
    index = block.index + (at[0] * slab.shape[1] + at[1]) * slab.shape[2] + at[2]
    distance = block.unscale * least_distance(least, p, block.radius2, is_near(block.radius2, block.cell.half2))
    if block.slices > 1:
        if least < LARGEST_SQUARE:
            shrink(out.values, index, distance)
        return 0
    if not least < LARGEST_SQUARE:
        # Left to the search: the list had no room, the block is too coarse, or float32 overflowed.
        distance = float(wp.inf)
        fetch_add(out.missed, 0, 1)
    return write_distance(out, index, distance)


@wp.func
def measure_voxels(
    tree: Tree,
    slab: Slab,
    out: Output,
    features: Features,
    worker: int,
    rows: wp.uint64,
    counts: Counts,
    block: Block,
    again: bool,
    last: bool,
    lane: int,
    lanes: int,
):
    """Measure all voxels of a block from the features listed now, and those before if `again`.

    What was found is written if this is the `last` time, else noted. Returns the unclear voxels that were written.
    """
    unclear = int(0)
    near = is_near(block.radius2, block.cell.half2)
    half = block.cell.half
    room = NEAR_ENDS * (half[0] + half[1] + half[2])
    total = 1 << (3 * block.bits)
    if on_cpu():
        first = _VOXELS * worker
        if not again:
            for v in range(total):
                p = local_voxel(tree, slab, rows, block, v)
                for axis in range(3):
                    features.points[3 * first + axis * _VOXELS + v] = p[axis]
                features.least[first + v] = float(wp.inf)
        lessen_values(
            rows,
            counts.corners,
            counts.edges,
            counts.faces,
            features.points,
            3 * first,
            features.least,
            first,
            total,
            room,
            near,
        )
        if last:
            for v in range(total):
                at = 3 * first + v
                p = wp.vec3(features.points[at], features.points[at + _VOXELS], features.points[at + 2 * _VOXELS])
                unclear = unclear + finish_voxel(slab, out, block, v, p, features.least[first + v])
        return unclear
    # Two voxels at a time: each feature is loaded once for both.
    v = lane
    while v < total / 2:
        w = v + total / 2
        p = local_voxel(tree, slab, rows, block, v)
        q = local_voxel(tree, slab, rows, block, w)
        least = wp.vec2(wp.inf, wp.inf)
        if again:
            least = wp.vec2(features.least[_VOXELS * worker + v], features.least[_VOXELS * worker + w])
        least = least_values(least, rows, counts.corners, counts.edges, counts.faces, p, q, room, near)
        if last:
            unclear = unclear + finish_voxel(slab, out, block, v, p, least[0])
            unclear = unclear + finish_voxel(slab, out, block, w, q, least[1])
        else:
            features.least[_VOXELS * worker + v] = least[0]
            features.least[_VOXELS * worker + w] = least[1]
        v = v + lanes
    return unclear


@wp.func
def measure_block(
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
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
        if on_cpu():
            known = nearest_in_list(frames, parts, lists, first, block.cell.centre, known)
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
    frames: wp.array(dtype=wp.float32),
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
                frames,
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
    frames: wp.array,
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
    inputs = [lanes, tree, frames, parts, cones, slab, lists, features, stacks, out]
    launch(_measure_blocks, workers * lanes, inputs, frames.device, smallest=1)
