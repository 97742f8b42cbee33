"""Cells of a segment: which edges the surface crosses, and which case each cell is."""

from __future__ import annotations

import warp as wp

from sdm.kernels.surface.voxel_rows import Segment, Voxels, are_there, segment_of, value_at

wp.set_module_options({"enable_backward": False})

ALL = (1 << 8) - 1


@wp.struct
class Cases:
    """The tables of `cell_cases` on a device."""

    first: wp.array(dtype=wp.int32)
    ambiguous: wp.array(dtype=wp.int32)
    triangles: wp.array(dtype=wp.int32)
    start: wp.array(dtype=wp.int32)
    centres: wp.array(dtype=wp.int32)
    loops: wp.array(dtype=wp.int32)
    loop: wp.array(dtype=wp.int32)
    opposite: wp.array(dtype=wp.int32)
    corners: wp.array(dtype=wp.int32)


@wp.struct
class Crossings:
    """Bits of the cells and edges of a segment."""

    edges: wp.int32  # bit 8a + k: the surface crosses the edge from voxel k along axis a
    cells: wp.int32  # bit k: the surface crosses the cell at voxel k
    rows: wp.vec4i  # the nine voxels of each row that are inside


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __popc(bits);
#else
    return __builtin_popcount(bits);
#endif
"""
)
def bits_of(bits: int) -> int:
    """Number of bits that are set."""
    ...


@wp.func
def crossings_of(voxels: Voxels, segment: Segment):
    """Edges and cells of a segment that the surface crosses."""
    found = Crossings()
    if segment.rows[0] < 0 and segment.nexts[0] < 0:
        return found
    there = wp.vec4i(0, 0, 0, 0)
    for q in range(4):
        there[q] = are_there(segment, q)
        bits = int(0)
        for k in range(9):
            if ((there[q] >> k) & 1) != 0 and value_at(voxels, segment, q, k) < voxels.level:
                bits = bits | (1 << k)
        found.rows[q] = bits
    b = found.rows
    x = (b[0] ^ b[2]) & there[0] & there[2]
    y = (b[0] ^ b[1]) & there[0] & there[1]
    z = (b[0] ^ (b[0] >> 1)) & there[0] & (there[0] >> 1)
    found.edges = (x & ALL) | ((y & ALL) << 8) | ((z & ALL) << 16)
    whole = there[0] & there[1] & there[2] & there[3]
    any_in = b[0] | b[1] | b[2] | b[3]
    all_in = b[0] & b[1] & b[2] & b[3]
    any_in = any_in | (any_in >> 1)
    all_in = all_in & (all_in >> 1)
    found.cells = whole & (whole >> 1) & any_in & ~all_in & ALL
    return found


@wp.func
def inside_of(crossings: Crossings, k: int):
    """A bit for each corner of cell k that is inside."""
    b = crossings.rows
    pairs = ((b[0] >> k) & 3) | (((b[1] >> k) & 3) << 2) | (((b[2] >> k) & 3) << 4) | (((b[3] >> k) & 3) << 6)
    return pairs


@wp.func
def above_level(voxels: Voxels, segment: Segment, k: int, corner: int):
    """The value at a corner of cell k, less the level."""
    value = value_at(voxels, segment, corner >> 1, k + (corner & 1))
    return wp.float64(value) - wp.float64(voxels.level)


@wp.func
def is_joined(voxels: Voxels, cases: Cases, segment: Segment, k: int, inside: int, face: int):
    """True if the inside corners of an ambiguous face of cell k are joined: the bilinear saddle between is inside.

    Products of float32 are exact in float64 where the level is zero, and in any case the same for both cells.
    """
    products = wp.vec2d(wp.float64(1.0), wp.float64(1.0))
    for n in range(4):
        corner = cases.corners[4 * face + n]
        value = above_level(voxels, segment, k, corner)
        side = 1 - ((inside >> corner) & 1)
        products[side] = products[side] * value
    return products[0] > products[1]


@wp.func
def case_of(voxels: Voxels, cases: Cases, segment: Segment, crossings: Crossings, k: int):
    """The case of cell k, by the asymptotic decider."""
    inside = inside_of(crossings, k)
    case = int(cases.first[inside])
    unclear = cases.ambiguous[inside]
    bit = int(1)
    for face in range(6):
        if ((unclear >> face) & 1) != 0:
            if is_joined(voxels, cases, segment, k, inside, face):
                case = case + bit
            bit = bit * 2
    return case


@wp.func
def counts_of(voxels: Voxels, cases: Cases, block: int, line: int):
    """Vertices and triangles of a segment, and the edges that have vertices."""
    segment = segment_of(voxels, block, line)
    crossings = crossings_of(voxels, segment)
    vertices = bits_of(crossings.edges)
    triangles = int(0)
    if crossings.cells != 0:
        for k in range(8):
            if ((crossings.cells >> k) & 1) != 0:
                case = case_of(voxels, cases, segment, crossings, k)
                vertices += bits_of(cases.centres[case])
                triangles += cases.start[case + 1] - cases.start[case]
    return wp.vec3i(vertices, triangles, crossings.edges)
