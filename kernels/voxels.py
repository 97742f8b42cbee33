"""The voxels of one block: where they are, how they are measured from the rows of features, what is written.

On a GPU each lane holds two voxels, so that each row is loaded once for both; on a CPU they lie in arrays, for loops
that a compiler turns into vectors.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.cull import Cell
from sdm.kernels.features import (
    NEAR_ENDS,
    VOXELS,
    Counts,
    Features,
    is_near,
    least_distance,
    least_values,
    lessen_values,
    read_place,
    write_place,
)
from sdm.kernels.grid import Output, Slab, along, voxel, write_distance
from sdm.kernels.lanes import fetch_add, on_cpu, shrink
from sdm.kernels.lists import is_within
from sdm.kernels.tree import FRAME_SIZE, SCALE, Tree

wp.set_module_options({"enable_backward": False})

# Squares beyond this one may overflow.
LARGEST_SQUARE = wp.constant(1.0e36)

_VOXELS = wp.constant(VOXELS)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)


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
