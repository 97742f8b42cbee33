"""The voxels of one block: where they are, how they are measured from the rows of parts, what is written.

On a GPU each lane holds two voxels, so that each row is loaded once for both; on a CPU they lie in arrays, for loops
that a compiler turns into vectors.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.atomics import fetch_add, shrink
from sdm.kernels.cull import Cell
from sdm.kernels.features import Counts
from sdm.kernels.grid import Output, Slab, along, voxel, write_signed
from sdm.kernels.lanes import on_cpu
from sdm.kernels.least import OCTANT, VOXELS, is_near, least_distance, least_values, lessen_values
from sdm.kernels.lists import is_within, octant_at
from sdm.kernels.octants import Octants, note_lattice
from sdm.kernels.rows import PLACES, read_number, write_number
from sdm.kernels.tree import FRAME_SIZE, SCALE, Tree

wp.set_module_options({"enable_backward": False})

# Squares beyond this one may overflow.
LARGEST_SQUARE = wp.constant(1.0e36)

# Room for rounding in "between the ends" and "inside the planes", in units of the sum of the block's half-widths.
NEAR_ENDS = wp.constant(2.0e-7)

_VOXELS, _OCTANT, _PLACES = wp.constant(VOXELS), wp.constant(OCTANT), wp.constant(PLACES)
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


@wp.struct
class Features:
    """What all workers note, each in its own part; the rows are in shared memory on a GPU."""

    rows: wp.array(dtype=wp.float32)  # (workers * ROWS * 4) on a CPU
    points: wp.array(dtype=wp.float32)  # (workers * 3 * 512) x, y and z of a block's voxels from its centre, on a CPU
    least: wp.array(dtype=wp.float32)  # (workers * 512) the least values of a block's voxels so far


@wp.func
def index_in(v: int):
    """Voxel v of a block, octant by octant: its indices from the block's first."""
    return 4 * octant_at(v >> 6) + wp.vec3i((v >> 4) & 3, (v >> 2) & 3, v & 3)


@wp.func
def note_places(tree: Tree, slab: Slab, rows: wp.uint64, block: Block, lane: int, lanes: int):
    """Note the voxels' coordinates along each axis, from the block's centre; a turned grid's are not so simple.

    And where they would be if they were not rounded, of any grid.
    """
    scale = tree.frame[block.mesh * _FRAME_SIZE + _SCALE]
    note_lattice(slab, rows, block.start, block.cell, scale, lane, lanes)
    at = lane
    while at < 8:
        for axis in range(3):
            p = scale * wp.float64(along(slab, axis, block.start[axis] + at))
            write_number(rows, _PLACES + 8 * axis + at, float(p - wp.float64(block.cell.centre[axis])))
        at = at + lanes


@wp.func
def local_voxel(tree: Tree, slab: Slab, rows: wp.uint64, block: Block, at: wp.vec3i):
    """The voxel `at` from a block's first, from the block's centre."""
    if slab.turned != 0:
        scale = tree.frame[block.mesh * _FRAME_SIZE + _SCALE]
        p = voxel(slab, block.start[0] + at[0], block.start[1] + at[1], block.start[2] + at[2])
        return wp.vec3(scale * wp.vec3d(p) - wp.vec3d(block.cell.centre))
    x = read_number(rows, _PLACES + at[0])
    y = read_number(rows, _PLACES + 8 + at[1])
    return wp.vec3(x, y, read_number(rows, _PLACES + 16 + at[2]))


@wp.func
def place_in_map(slab: Slab, block: Block, at: wp.vec3i):
    """Where the voxel `at` from a block's first is written, see `index_of`; -1 if it is beyond the slab."""
    if not is_within(slab, block.start + at):
        return -1
    return block.index + (at[0] * slab.shape[1] + at[1]) * slab.shape[2] + at[2]


@wp.func
def winding_in(out: Output, index: int):
    """The winding number of a voxel that will be settled: read before it is measured, as it takes a while to come.

    Of one beyond the slab, another's: to choose here would be to wait.
    """
    return out.values[wp.max(index, 0)]


@wp.func
def settle_voxel(out: Output, block: Block, index: int, winding: float, p: wp.vec3, least: float):
    """Write the distance of a voxel; 1 if its winding number is unclear.

    It is infinite where none was found.
    """
    distance = float(wp.inf)
    if least < LARGEST_SQUARE:
        near = is_near(block.radius2, block.cell.half2)
        distance = block.unscale * least_distance(least, p, block.radius2, near)
    if index < 0:
        return 0
    if block.slices > 1:
        if distance < float(wp.inf):
            shrink(out.values, index, distance)
        return 0
    if not distance < float(wp.inf):
        # Left to the search: the list had no room, the block is too coarse, or float32 overflowed.
        distance = float(wp.inf)
        fetch_add(out.missed, 0, 1)
    return write_signed(out, index, distance, winding)


@wp.func
def measure_voxels(
    tree: Tree,
    slab: Slab,
    out: Output,
    features: Features,
    worker: int,
    rows: wp.uint64,
    counts: Counts,
    octants: Octants,
    block: Block,
    again: bool,
    last: bool,
    lane: int,
    lanes: int,
):
    """Measure all voxels of a block from the parts listed now, and those before if `again`.

    What was found is written if this is the `last` time, else noted. Returns the unclear voxels that were written.
    """
    unclear = int(0)
    near = is_near(block.radius2, block.cell.half2)
    half = block.cell.half
    room = NEAR_ENDS * (half[0] + half[1] + half[2])
    turned = slab.turned != 0
    first = _VOXELS * worker
    octant = int(0)
    while (octants.there >> octant) != 0:
        if ((octants.there >> octant) & 1) != 0:
            begin = _OCTANT * octant
            if on_cpu():
                if not again:
                    for v in range(begin, begin + _OCTANT):
                        p = local_voxel(tree, slab, rows, block, index_in(v))
                        for axis in range(3):
                            features.points[3 * first + axis * _VOXELS + v] = p[axis]
                        features.least[first + v] = float(wp.inf)
                lessen_values(
                    rows,
                    counts.corners,
                    counts.edges,
                    counts.faces,
                    features.points,
                    3 * first + begin,
                    features.least,
                    first + begin,
                    room,
                    near,
                    turned,
                    octant,
                )
                if last:
                    for v in range(begin, begin + _OCTANT):
                        at = 3 * first + v
                        p = wp.vec3(
                            features.points[at], features.points[at + _VOXELS], features.points[at + 2 * _VOXELS]
                        )
                        index = place_in_map(slab, block, index_in(v))
                        winding = winding_in(out, index)
                        unclear = unclear + settle_voxel(out, block, index, winding, p, features.least[first + v])
            else:
                # Two voxels each lane, two apart along x: each row is loaded, and worked out across x, once for both.
                v = begin + lane
                w = v + _OCTANT / 2
                at_v = index_in(v)
                at_w = at_v + wp.vec3i(2, 0, 0)
                index_v = place_in_map(slab, block, at_v)
                index_w = place_in_map(slab, block, at_w)
                winding_v = winding_in(out, index_v)
                winding_w = winding_in(out, index_w)
                p = local_voxel(tree, slab, rows, block, at_v)
                q = local_voxel(tree, slab, rows, block, at_w)
                least = wp.vec2(wp.inf, wp.inf)
                if again:
                    least = wp.vec2(features.least[first + v], features.least[first + w])
                least = least_values(
                    least, rows, counts.corners, counts.edges, counts.faces, p, q, room, near, turned, octant, lane
                )
                if last:
                    unclear = unclear + settle_voxel(out, block, index_v, winding_v, p, least[0])
                    unclear = unclear + settle_voxel(out, block, index_w, winding_w, q, least[1])
                else:
                    features.least[first + v] = least[0]
                    features.least[first + w] = least[1]
        octant = octant + 1
    return unclear
