"""Third stage of the dense query: the distances themselves, block by block.

A block is a cell of 8^3 voxels whose list is short, or one of the eight bricks of 4^3 of a cell whose list is long.
One group of lanes takes one block. It filters the cell's list once more, for the block, lists the parts of the
triangles that are left, and measures the block's voxels from those.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cones import Cones, ball_matters
from sdm.kernels.cull import Cell, Witness, agree, no_witness, remember
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
from sdm.kernels.grid import Output, Slab, along, lessen_distance, voxel, write_distance
from sdm.kernels.lanes import (
    GPU_BLOCKS,
    ballot,
    fetch_add,
    fetch_add_once,
    load4,
    members,
    on_cpu,
    rank,
    wait_for_lanes,
    write4,
)
from sdm.kernels.lists import (
    BRICK,
    CELL,
    HEAVY,
    NEXT_BLOCK,
    NEXT_BRICK,
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
from sdm.kernels.regions import STACK
from sdm.kernels.tree import FRAME_SIZE, SCALE, UNSCALE, Tree
from sdm.kernels.witness import read_witness, seen_from

wp.set_module_options({"enable_backward": False})

# Eight slots, and eight squared distances.
Octants = wp.types.vector(length=8, dtype=wp.int32)
OctantDistances = wp.types.vector(length=8, dtype=wp.float32)
# Squares beyond this one may overflow.
LARGEST_SQUARE = wp.constant(1.0e36)

# A heavy cell's number, which of its slices, how many there are less one, in one integer.
SLICE_BITS, MOST_SLICES = 18, 64
_SLICE_BITS, _MOST_SLICES = wp.constant(SLICE_BITS), wp.constant(MOST_SLICES)
_STACK = wp.constant(STACK)
_VOXELS = wp.constant(VOXELS)
_HEAVY = wp.constant(HEAVY)
_NEXT_BLOCK = wp.constant(NEXT_BLOCK)
_NEXT_BRICK = wp.constant(NEXT_BRICK)
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
def nearest_of_cell(lists: Lists, number: int):
    """The surface point nearest to a cell's centre."""
    known = no_witness()
    for share in range(lists.shares):
        known = remember(known, read_witness(lists.nearest, number * lists.shares + share).to_surface)
    return known


@wp.func
def middle_of_octant(cell: Cell, octant: int):
    """About the centre of one of a cell's bricks."""
    half = 0.5 * cell.half
    return cell.centre + wp.vec3(
        wp.where((octant & 4) != 0, half[0], -half[0]),
        wp.where((octant & 2) != 0, half[1], -half[1]),
        wp.where((octant & 1) != 0, half[2], -half[2]),
    )


@wp.func
def find_brick_witnesses(
    frames: wp.array(dtype=wp.float32),
    parts: Parts,
    lists: Lists,
    number: int,
    cell: Cell,
    nearest: Witness,
    length: int,
    lane: int,
    lanes: int,
):
    """A surface point near each of a cell's bricks, seen from the middle of its octant: the cell's nearest or a nearer.

    On a GPU each lane measures the triangle of the list whose ball's centre is nearest of those that it sees.
    """
    best = Octants()
    best2 = OctantDistances()
    for o in range(8):
        best[o] = -1
        best2[o] = float(wp.inf)
    reader = Reader()
    if length > 0 and not on_cpu():
        reader = start_reading(lists.heads, lists.lengths, number * lists.shares, lists.shares)
    upcoming = read_entry(lists, reader, lane)
    while reader.left > 0:
        slot = upcoming
        reader = read_on(lists, lists.heads, lists.lengths, reader, lanes)
        upcoming = read_entry(lists, reader, lane)
        if slot >= 0:
            ball = load4(parts.balls, slot)
            for o in range(8):
                u = middle_of_octant(cell, o) - wp.vec3(ball[0], ball[1], ball[2])
                d2 = wp.dot(u, u)
                if d2 < best2[o]:
                    best2[o] = d2
                    best[o] = slot
    for o in range(8):
        middle = middle_of_octant(cell, o)
        known = remember(no_witness(), nearest.to_surface + (middle - cell.centre))
        if best[o] >= 0:
            known = remember(known, seen_from(frames, best[o], middle))
        known = agree(known, lane)
        if lane == 0:
            u = known.to_surface
            write4(lists.witnesses, 9 * lists.count + 8 * number + o, u[0], u[1], u[2], known.distance2)


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
    while at < 24:
        axis = at / 8
        p = scale * wp.float64(along(slab, axis, block.start[axis] + at % 8))
        write_place(rows, at, float(p - wp.float64(block.cell.centre[axis])))
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
def finish_voxel(tree: Tree, slab: Slab, out: Output, block: Block, v: int, p: wp.vec3, least: float):
    """Write the distance of a voxel; 1 if its winding number is unclear."""
    at = block.start + index_in(block, v)
    if not is_within(slab, at):
        return 0
    near = is_near(block.radius2, block.cell.half2)
    distance = least_distance(least, p, block.radius2, near)
    unscale = float(tree.frame[block.mesh * _FRAME_SIZE + _UNSCALE])
    if block.slices > 1:
        if least < LARGEST_SQUARE:
            lessen_distance(out, block.mesh, at[0], at[1], at[2], distance * unscale)
        return 0
    if not (least < LARGEST_SQUARE and distance < LARGEST_SQUARE):
        # Left to the search: the list had no room, the block is too coarse, or float32 overflowed.
        distance = float(wp.inf)
        fetch_add(out.missed, 0, 1)
    return write_distance(out, block.mesh, at[0], at[1], at[2], distance * unscale)


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
                unclear = unclear + finish_voxel(tree, slab, out, block, v, p, features.least[first + v])
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
            unclear = unclear + finish_voxel(tree, slab, out, block, v, p, least[0])
            unclear = unclear + finish_voxel(tree, slab, out, block, w, q, least[1])
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


@wp.func
def put_off(
    frames: wp.array(dtype=wp.float32),
    parts: Parts,
    slab: Slab,
    lists: Lists,
    out: Output,
    number: int,
    cell: Cell,
    known: Witness,
    length: int,
    slice_length: int,
    lane: int,
    lanes: int,
):
    """Have a cell measured brick by brick, by one group of lanes for every `slice_length` triangles of its list.

    Where those are several, they need a distance to lessen: an infinite one, with its sign. Returns the unclear voxels.
    """
    find_brick_witnesses(frames, parts, lists, number, cell, known, length, lane, lanes)
    slices = wp.clamp((length + slice_length - 1) / slice_length, 1, _MOST_SLICES)
    unclear = int(0)
    if slices > 1:
        mesh, start = cell_start(lists, number)
        v = lane
        while v < CELL * CELL * CELL:
            at = start + wp.vec3i(v / (CELL * CELL), (v / CELL) % CELL, v % CELL)
            if is_within(slab, at):
                unclear = unclear + write_distance(out, mesh, at[0], at[1], at[2], float(wp.inf))
            v = v + lanes
    if lane == 0:
        # Whether a slice's voxels are missed nobody knows before the last is done.
        if slices > 1:
            fetch_add(out.missed, 0, 1)
        first = fetch_add(lists.counts, _HEAVY, slices)
        for i in range(slices):
            lists.heavy[first + i] = number | (i << _SLICE_BITS) | ((slices - 1) << (_SLICE_BITS + 6))
    return unclear


@wp.kernel(launch_bounds=(128, GPU_BLOCKS))
def _measure_blocks(
    begin: int,
    lanes: int,
    longest: int,
    slice_length: int,
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
    bits = int(2)
    total = 8 * lists.counts[_HEAVY]
    counter = _NEXT_BRICK
    if longest > 0:
        bits = int(3)
        total = 8 * lists.count
        counter = _NEXT_BLOCK
    item = fetch_add_once(lists.counts, counter, 1, lane)
    while item < total:
        block = Block()
        block.bits = bits
        block.slices = 1
        number = item
        if longest == 0:
            code = lists.heavy[item / 8]
            number = code & ((1 << _SLICE_BITS) - 1)
            block.slice = (code >> _SLICE_BITS) & (_MOST_SLICES - 1)
            block.slices = 1 + (code >> (_SLICE_BITS + 6))
        mesh, start = cell_start(lists, number)
        scale = float(tree.frame[mesh * _FRAME_SIZE + _SCALE])
        cell = make_cell(slab, start, CELL, scale)
        known = no_witness()
        block.mesh = mesh
        block.start = start
        block.cell = cell
        wanted = is_within(slab, start)
        if longest == 0:
            block.start = start + BRICK * octant_at(item)
            wanted = is_within(slab, block.start)
            block.cell = make_cell(slab, block.start, BRICK, scale)
            octant = item % 8
            known = read_witness(lists.witnesses, 9 * lists.count + 8 * number + octant)
            known = remember(no_witness(), known.to_surface + (block.cell.centre - middle_of_octant(cell, octant)))
        elif wanted:
            length = list_length(lists.heads, lists.lengths, number * lists.shares, lists.shares)
            if length > 0:
                known = nearest_of_cell(lists, number)
            wanted = length >= 0 and length <= longest and not is_coarse(cell)
            if not wanted:
                unclear = put_off(
                    frames, parts, slab, lists, out, number, cell, known, length, slice_length, lane, lanes
                )
                if unclear > 0:
                    fetch_add(out.ambiguous, mesh, unclear)
        if wanted:
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
        item = fetch_add_once(lists.counts, counter, 1, lane)


def measure_blocks(
    tree: Tree,
    frames: wp.array,
    parts: Parts,
    cones: Cones,
    slab: Slab,
    lists: Lists,
    longest: int,
    slice_length: int,
    features: Features,
    stacks: wp.array,
    out: Output,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Distances of every voxel of one pass: cells of up to `longest` triangles whole, others brick by brick.

    One group of lanes takes up to `slice_length` triangles. `features` and `stacks` are scratch. Voxels of cells whose
    list found no room become infinite with their sign, and are counted in `out.missed`.
    """
    for most in (longest, 0):
        inputs = [lanes, most, slice_length, tree, frames, parts, cones, slab, lists, features, stacks, out]
        launch(_measure_blocks, workers * lanes, inputs, frames.device, smallest=1)
