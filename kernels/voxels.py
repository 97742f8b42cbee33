"""The voxels of one block: where they are, and what is written."""

from __future__ import annotations

import warp as wp

from sdm.kernels.atomics import fetch_add, shrink
from sdm.kernels.cull import LARGEST_SQUARE, Cell, Witness
from sdm.kernels.grid import Output, Slab, along, distances_at, is_unclear, with_sign
from sdm.kernels.least import four_at, is_near, least_distance, values_of
from sdm.kernels.lists import is_within
from sdm.kernels.octants import lattice_of, note_lattice, note_witness
from sdm.kernels.rows import PLACES, WINDING, read_number, read_row, write_number, write_row
from sdm.kernels.tree import FRAME_SIZE, SCALE, Tree

wp.set_module_options({"enable_backward": False})

# Room for rounding in "between the ends" and "inside the planes", in units of the sum of the block's half-widths.
NEAR_ENDS = wp.constant(2.0e-7)

_PLACES, _WINDING_ROW = wp.constant(PLACES), wp.constant(WINDING // 4)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)


@wp.struct
class Block:
    """Up to 8^3 or 4^3 voxels of a mesh's map, or 16^3 whose bricks have one list."""

    mesh: wp.int32
    start: wp.vec3i  # its first voxel
    bits: wp.int32  # 2 to 4: the voxels along each edge are 2^bits
    slice: wp.int32  # which part of its cell's list counts: every `slices`-th batch of the lanes' entries
    slices: wp.int32
    index: wp.int32  # of its first voxel, see `index_of`
    unscale: float  # from scaled distances to the mesh's unit
    cell: Cell
    known: Witness  # the surface point nearest to its centre


@wp.func
def note_places(tree: Tree, slab: Slab, rows: wp.uint64, block: Block, lane: int, lanes: int):
    """Note the voxels' coordinates along each axis, from the block's centre; a turned grid's are not so simple.

    And where they would be if they were not rounded, of any grid, and the block's witness.
    """
    scale = tree.frame[block.mesh * _FRAME_SIZE + _SCALE]
    note_lattice(slab, rows, block.start, block.cell, scale, lane, lanes)
    note_witness(rows, block.cell, block.known, lane)
    at = lane
    while at < 8:
        for axis in range(3):
            p = scale * wp.float64(along(slab, axis, block.start[axis] + at))
            write_number(rows, _PLACES + 8 * axis + at, float(p - wp.float64(block.cell.centre[axis])))
        at = at + lanes


@wp.struct
class Four:
    """Four voxels along z, from the block's centre."""

    p0: wp.vec3
    p1: wp.vec3
    p2: wp.vec3
    p3: wp.vec3


@wp.func
def four_voxels(slab: Slab, rows: wp.uint64, at: wp.vec3i):
    """The voxel `at` from a block's first, and the next three."""
    if slab.turned != 0:
        lattice = lattice_of(rows)
        p = lattice.first + (float(at[0]) * lattice.i + float(at[1]) * lattice.j + float(at[2]) * lattice.k)
        return Four(p, p + lattice.k, p + 2.0 * lattice.k, p + 3.0 * lattice.k)
    x = read_number(rows, _PLACES + at[0])
    y = read_number(rows, _PLACES + 8 + at[1])
    z = read_row(rows, (_PLACES + 16 + at[2]) / 4)
    return Four(wp.vec3(x, y, z[0]), wp.vec3(x, y, z[1]), wp.vec3(x, y, z[2]), wp.vec3(x, y, z[3]))


@wp.func
def place_in_map(slab: Slab, block: Block, at: wp.vec3i):
    """Where the voxel `at` from a block's first is written, see `index_of`; -1 if it is beyond the slab."""
    if not is_within(slab, block.start + at):
        return -1
    return block.index + (at[0] * slab.shape[1] + at[1]) * slab.shape[2] + at[2]


@wp.func_native(
    snippet=f"""
    float* to = reinterpret_cast<float*>(rows) + {WINDING} + 4 * four;
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
    rows: wp.uint64, four: int, values: wp.array(dtype=wp.float32), index: int, count: int, together: bool
):
    """Have up to four values copied to the rows while other work goes on, until `end_reading`.

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
    """What this lane began to read is there."""
    ...


@wp.func_native(
    snippet=f"""
    const float* from = reinterpret_cast<const float*>(rows) + {WINDING} + 4 * four;
    float* to = reinterpret_cast<float*>(address) + index;
#if defined(__CUDA_ARCH__)
    if (together) {{
        *reinterpret_cast<float4*>(to) = *reinterpret_cast<const float4*>(from);
        return;
    }}
#endif
    #pragma unroll 1
    for (int i = 0; i < count; ++i) to[i] = from[i];
"""
)
def write_back(rows: wp.uint64, four: int, address: wp.uint64, index: int, count: int, together: bool):
    """Write what stands where `begin_reading` had put them; `together` as there."""
    ...


@wp.func
def fours_of(block: Block):
    """How many times four voxels, next to each other along z, a block has."""
    return 1 << (3 * block.bits - 2)


@wp.func
def read_windings(slab: Slab, out: Output, rows: wp.uint64, block: Block, lane: int, lanes: int):
    """Begin to read the winding numbers of a block's voxels: they take a while to come, and are needed at the end."""
    four = lane
    while four < fours_of(block):
        at = four_at(four)
        index = place_in_map(slab, block, at)
        if index >= 0:
            count = wp.min(4, slab.shape[2] - block.start[2] - at[2])
            begin_reading(rows, four, out.values, index, count, slab.shape[2] % 4 == 0)
        four = four + lanes


@wp.func
def settled(block: Block, p: wp.vec3, least: float, near: bool):
    """The distance of a voxel; infinite if none was found: the list had no room, or float32 overflowed."""
    distance = block.unscale * least_distance(least, p, block.known.distance2, near)
    return wp.where(least < LARGEST_SQUARE and distance < float(wp.inf), distance, float(wp.inf))


@wp.func
def settle_voxels(slab: Slab, out: Output, rows: wp.uint64, block: Block, lane: int, lanes: int):
    """Write the distances of all voxels of a measured block; returns how many of them have unclear winding numbers.

    They are infinite where none was found, and left to the search. Each lane reads what it began to read itself.
    """
    unclear = int(0)
    missed = int(0)
    near = is_near(block.known.distance2, block.cell.half2)
    address = distances_at(out)
    end_reading()
    four = lane
    while four < fours_of(block):
        at = four_at(four)
        index = place_in_map(slab, block, at)
        if index >= 0:
            least = values_of(rows, four)
            winding = read_row(rows, _WINDING_ROW + four)
            p = four_voxels(slab, rows, at)
            distances = wp.vec4(
                settled(block, p.p0, least[0], near),
                settled(block, p.p1, least[1], near),
                settled(block, p.p2, least[2], near),
                settled(block, p.p3, least[3], near),
            )
            count = wp.min(4, slab.shape[2] - block.start[2] - at[2])
            for v in range(4):
                if block.slices > 1:
                    if v < count and distances[v] < float(wp.inf):
                        shrink(out.values, index + v, distances[v])
                elif v < count:
                    missed = missed + wp.where(distances[v] < float(wp.inf), 0, 1)
                    unclear = unclear + is_unclear(winding[v])
            if block.slices == 1:
                write_row(
                    rows,
                    _WINDING_ROW + four,
                    with_sign(distances[0], winding[0]),
                    with_sign(distances[1], winding[1]),
                    with_sign(distances[2], winding[2]),
                    with_sign(distances[3], winding[3]),
                )
                write_back(rows, four, address, index, count, slab.shape[2] % 4 == 0)
        four = four + lanes
    if missed > 0:
        fetch_add(out.missed, 0, missed)
    return unclear
