"""Voxels of one block: their coordinates, their winding numbers, and the distances that are written."""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.culling.witness_bound import LARGEST_SQUARE, Witness
from sdm.kernels.dense.block.min_values import two_at, values_of
from sdm.kernels.dense.block.octant_tests import write_block_witness, write_lattice
from sdm.kernels.dense.block.shared_layout import (
    BLOCK_ROW,
    COORDINATES,
    WINDING,
    read_row,
    read_whole_row,
    write_float,
    write_row,
    write_whole_row,
)
from sdm.kernels.dense.block.whole_blocks import fetch_whole, is_whole, write_whole
from sdm.kernels.geometry.voxel_box import VoxelBox, is_within
from sdm.kernels.geometry.voxel_grid import Output, Slab, along, distances_at, is_unclear, with_sign
from sdm.kernels.primitives.atomics import fetch_add, shrink
from sdm.kernels.primitives.lanes import wait_for_lanes

wp.set_module_options({"enable_backward": False})

# Room for rounding in "between the ends" and "inside the planes", in units of the sum of the block's half-widths.
NEAR_ENDS = 2.0e-7


@wp.struct
class Block:
    """Up to 8^3 or 4^3 voxels of a mesh's map, or 16^3 whose bricks have one list."""

    mesh: wp.int32
    start: wp.vec3i  # its first voxel
    bits: wp.int32  # 2 to 4: the voxels along each edge are 2^bits
    split: wp.int32  # which split of its cell's list counts: every `splits`-th batch of the lanes' entries
    splits: wp.int32
    index: wp.int32  # of its first voxel, see `index_of`
    unscale: float  # from scaled distances to the mesh's unit
    box: VoxelBox
    known: Witness  # the surface point nearest to its centre
    floor: float  # less than any distance of its voxels; 0 near the surface, see `feature_setup`


@wp.func
def keep_block(scratch: wp.uint64, block: Block, lane: int):
    """Write what is looked at again of a block: what a GPU's lanes all keep in registers, others cannot have."""
    if lane == 0:
        c = block.box.centre
        h = block.box.half
        s = block.start
        write_row(scratch, BLOCK_ROW, c[0], c[1], c[2], block.floor)
        write_row(scratch, BLOCK_ROW + 1, h[0], h[1], h[2], block.unscale)
        write_whole_row(scratch, BLOCK_ROW + 2, s[0], s[1], s[2], block.index)
        write_whole_row(scratch, BLOCK_ROW + 3, block.mesh, block.bits, block.split, block.splits)


@wp.func
def kept_block(scratch: wp.uint64):
    """The block that was written; of its box the centre and the half-widths, and nothing of its witness."""
    r0 = read_row(scratch, BLOCK_ROW)
    r1 = read_row(scratch, BLOCK_ROW + 1)
    r2 = read_whole_row(scratch, BLOCK_ROW + 2)
    r3 = read_whole_row(scratch, BLOCK_ROW + 3)
    block = Block()
    block.mesh = r3[0]
    block.start = wp.vec3i(r2[0], r2[1], r2[2])
    block.bits = r3[1]
    block.split = r3[2]
    block.splits = r3[3]
    block.index = r2[3]
    block.unscale = r1[3]
    block.box.centre = wp.vec3(r0[0], r0[1], r0[2])
    block.box.half = wp.vec3(r1[0], r1[1], r1[2])
    block.floor = r0[3]
    return block


@wp.func
def write_coordinates(tree: Tree, slab: Slab, scratch: wp.uint64, block: Block, lane: int, lanes: int):
    """Write the voxels' coordinates along each axis, from the block's centre; a turned grid's are not so simple.

    And where they would be if they were not rounded, of any grid, and the block's witness.
    """
    scale = tree.frame[block.mesh * FRAME_SIZE + SCALE]
    write_lattice(slab, scratch, block.start, block.box, scale, lane, lanes)
    write_block_witness(scratch, block.box, block.known, lane)
    at = lane
    while at < 8:
        for axis in range(3):
            p = scale * wp.float64(along(slab, axis, block.start[axis] + at))
            write_float(scratch, COORDINATES + 8 * axis + at, float(p - wp.float64(block.box.centre[axis])))
        at = at + lanes


@wp.func
def voxel_index(slab: Slab, block: Block, at: wp.vec3i):
    """Index of the voxel `at` from a block's first, see `index_of`; -1 if it is beyond the slab."""
    if not is_within(slab, block.start + at):
        return -1
    return block.index + (at[0] * slab.shape[1] + at[1]) * slab.shape[2] + at[2]


@wp.func_native(
    snippet=f"""
    float* to = reinterpret_cast<float*>(scratch) + {WINDING} + 4 * four;
    const float* from = values.data + index;
#if defined(__CUDA_ARCH__)
    const unsigned there = (unsigned)__cvta_generic_to_shared(to);
    if (together) {{
        asm volatile("cp.async.cg.shared.global [%0], [%1], 16;" :: "r"(there), "l"(from) : "memory");
    }} else {{
        #pragma unroll 1
        for (int i = 0; i < count; ++i)
            asm volatile("cp.async.ca.shared.global [%0], [%1], 4;" :: "r"(there + 4 * i), "l"(from + i) : "memory");
    }}
#else
    for (int i = 0; i < count; ++i) to[i] = from[i];
#endif
"""
)
def begin_reading(
    scratch: wp.uint64, four: int, values: wp.array(dtype=wp.float32), index: int, count: int, together: bool
):
    """Have up to four values copied to the scratch memory while other work goes on, until `end_reading`.

    `together`: there are four, and they lie at a multiple of 16 bytes.
    """
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    asm volatile("cp.async.wait_all;" ::: "memory");
#endif
"""
)
def end_reading():
    """Wait until what this lane began to read is there."""
    ...


@wp.func_native(
    snippet=f"""
    // Of the bits of `number` the third is that of the second two of four.
    const unsigned n = number, place = (n >> 3 << 4) + (n << 2 & 12) + (n >> 1 & 2);
    const float* at = reinterpret_cast<const float*>(scratch) + {WINDING} + place;
#if defined(__CUDA_ARCH__)
    const float2 two = *reinterpret_cast<const float2*>(at);
    return wp::vec2(two.x, two.y);
#else
    return wp::vec2(at[0], at[1]);
#endif
"""
)
def windings_of(scratch: wp.uint64, number: int) -> wp.vec2:
    """Winding numbers of the voxels `number`, see `two_at`, that `begin_reading` had read."""
    ...


@wp.func_native(
    snippet="""
    float* to = reinterpret_cast<float*>(address) + index;
#if defined(__CUDA_ARCH__)
    if (together) {
        *reinterpret_cast<float2*>(to) = make_float2(first, second);
        return;
    }
#endif
    to[0] = first;
    if (count > 1) to[1] = second;
"""
)
def write_two(address: wp.uint64, index: int, first: float, second: float, count: int, together: bool):
    """Write one or two distances; `together`: at a multiple of 8 bytes."""
    ...


@wp.func
def twos_of(block: Block):
    """Number of pairs of voxels, next to each other along z, in a block."""
    return 1 << (3 * block.bits - 1)


@wp.func
def is_whole_block(slab: Slab, block: Block, lanes: int):
    """True if a block is of 8^3 voxels, all of which are there; see `whole_blocks`."""
    n = slab.shape
    return is_whole(block.start[0], block.start[1], block.start[2], n[0], n[1], n[2], block.bits, lanes)


@wp.func
def fetch_windings(slab: Slab, out: Output, block: Block, lane: int, lanes: int):
    """Have the winding numbers of most blocks come nearer, into a GPU's cache, until they are read in the end."""
    if is_whole_block(slab, block, lanes):
        fetch_whole(out.values, block.index, slab.shape[1], slab.shape[2], lane)


@wp.func
def read_windings(
    slab: Slab, out: Output, scratch: wp.uint64, block: Block, octants: int, parts: int, lane: int, lanes: int
):
    """Begin to read the winding numbers of a block's octants: they take a while to come, and are needed at the end."""
    four = lane
    while 2 * four < twos_of(block):
        at = two_at(four + (four & ~3))
        index = voxel_index(slab, block, at)
        # An octant has 64 voxels.
        if index >= 0 and (parts == 1 or (octants >> (four >> 4) & 1) != 0):
            count = wp.min(4, slab.shape[2] - block.start[2] - at[2])
            begin_reading(scratch, four, out.values, index, count, slab.shape[2] % 4 == 0)
        four = four + lanes


@wp.func
def distance_of(block: Block, value: float):
    """The distance of a voxel; infinite if none was found: the list had no room, or float32 overflowed."""
    distance = block.unscale * wp.sqrt(wp.max(block.floor * block.floor + value, 0.0))
    return wp.where(value < LARGEST_SQUARE and distance < float(wp.inf), distance, float(wp.inf))


@wp.func
def write_voxels(
    slab: Slab,
    out: Output,
    scratch: wp.uint64,
    block: Block,
    octants: int,
    parts: int,
    are_read: bool,
    lane: int,
    lanes: int,
):
    """Write the distances of all voxels of a block's measured octants; returns how many have unclear winding numbers.

    They are infinite where none was found, and left to the search. `are_read`: by `read_windings`, the winding numbers.
    """
    unclear = int(0)
    missed = int(0)
    address = distances_at(out)
    if are_read:
        end_reading()
        wait_for_lanes()
    elif parts == 1 and block.splits == 1 and is_whole_block(slab, block, lanes):
        ny = slab.shape[1]
        nz = slab.shape[2]
        if write_whole(scratch, out.values, address, block.index, ny, nz, block.unscale, block.floor, lane):
            return 0
    two = lane
    while two < twos_of(block):
        at = two_at(two)
        index = voxel_index(slab, block, at)
        if index >= 0 and (parts == 1 or (octants >> (two >> 5) & 1) != 0):
            least = values_of(scratch, two)
            count = wp.min(2, slab.shape[2] - block.start[2] - at[2])
            winding = wp.vec2()
            if are_read:
                winding = windings_of(scratch, two)
            elif block.splits == 1:
                winding = wp.vec2(out.values[index], out.values[index + count - 1])
            first = distance_of(block, least[0])
            second = distance_of(block, least[1])
            if block.splits > 1:
                if first < float(wp.inf):
                    shrink(out.values, index, first)
                if count > 1 and second < float(wp.inf):
                    shrink(out.values, index + 1, second)
            else:
                missed = missed + wp.where(first < float(wp.inf), 0, 1)
                unclear = unclear + is_unclear(winding[0])
                if count > 1:
                    missed = missed + wp.where(second < float(wp.inf), 0, 1)
                    unclear = unclear + is_unclear(winding[1])
                first = with_sign(first, winding[0])
                second = with_sign(second, winding[1])
                write_two(address, index, first, second, count, slab.shape[2] % 2 == 0)
        two = two + lanes
    if missed > 0:
        fetch_add(out.missed, 0, missed)
    return unclear
