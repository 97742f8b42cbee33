"""Which octants of a block can a part be nearest to?

A block of 8^3 voxels has eight octants of 4^3. All parts that matter to the block are worked out once, for its centre,
and each octant is measured from those that matter to it. That is asked as for the block in `parts`: x being the point
of the surface that is nearest to p, (p - x).u <= 0 for certain directions u of each part, and no part matters to an
octant of which no point fulfils one of these inequalities.

For a box with half-widths h around o, both from the block's centre, and x at q from there, the least (p - x).u is
o.u - q.u - sum_i h_i |u_i|, so that all octants are compared with one number.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.cull import Cell
from sdm.kernels.grid import Slab, place_of, reach_of
from sdm.kernels.parts import ROOM, reach, sum_abs
from sdm.kernels.rows import OCTANT_ROW, write_row

wp.set_module_options({"enable_backward": False})

# How much wider an octant may be than the first for rounding of its voxels' coordinates, in units of those.
WIDER = wp.constant(5.0e-7)
_OCTANT_ROW = wp.constant(OCTANT_ROW)


@wp.struct
class Octants:
    """The octants of a block."""

    half: wp.vec3  # half-widths of the largest
    there: wp.int32  # one bit for each that has voxels


@wp.func
def middle_of(start: int, count: int, side: int):
    """Along one axis the middle index of the voxels on one side (0 or 1) of a block, and half their number less one.

    Of a side without voxels: of what would be there.
    """
    last = wp.min(start + 4 * side + 3, wp.max(count - 1, start + 4 * side))
    first = start + 4 * side
    return 0.5 * float(first + last), 0.5 * float(last - first)


@wp.func
def note_octants(
    slab: Slab, rows: wp.uint64, start: wp.vec3i, bits: int, cell: Cell, scale: wp.float64, lane: int, lanes: int
):
    """Note where the octants of a block (`cell`) are. A block of 4^3 voxels is one octant by itself."""
    octants = Octants()
    octants.half = cell.half
    octants.there = 1
    if bits == 2:
        if lane == 0:
            write_row(rows, _OCTANT_ROW, 0.0, 0.0, 0.0, 0.0)
        return octants
    _i, half_i = middle_of(start[0], slab.shape[0], 0)
    _j, half_j = middle_of(start[1], slab.shape[1], 0)
    _k, half_k = middle_of(start[2], slab.shape[2], 0)
    half = wp.vec3(scale * reach_of(slab, wp.vec3d(wp.vec3(half_i, half_j, half_k))))
    octants.half = half + WIDER * (
        wp.vec3(wp.abs(cell.centre[0]), wp.abs(cell.centre[1]), wp.abs(cell.centre[2])) + half
    )
    # The bits of octants on the far side of an axis go where that side has no voxels.
    there = int(255)
    if start[0] + 4 >= slab.shape[0]:
        there = there & 15
    if start[1] + 4 >= slab.shape[1]:
        there = there & 51
    if start[2] + 4 >= slab.shape[2]:
        there = there & 85
    octants.there = there
    o = lane
    while o < 8:
        i, _hi = middle_of(start[0], slab.shape[0], (o >> 2) & 1)
        j, _hj = middle_of(start[1], slab.shape[1], (o >> 1) & 1)
        k, _hk = middle_of(start[2], slab.shape[2], o & 1)
        offset = wp.vec3(scale * place_of(slab, wp.vec3d(wp.vec3(i, j, k))) - wp.vec3d(cell.centre))
        write_row(rows, _OCTANT_ROW + o, offset[0], offset[1], offset[2], 0.0)
        o = o + lanes
    return octants


@wp.func_native(
    snippet=f"""
    struct alignas(16) Row {{ float x, y, z, w; }};
    const Row* row = reinterpret_cast<const Row*>(rows) + {OCTANT_ROW};
    int found = 0;
#if defined(__CUDA_ARCH__)
    // Short code: a multiprocessor waits for instructions that do not fit into its cache.
    #pragma unroll 1
#endif
    for (int o = 0; o < 8; ++o)
        found |= (int)(row[o].x * x + row[o].y * y + row[o].z * z <= limit) << o;
    return found;
"""
)
def octants_up_to(rows: wp.uint64, x: float, y: float, z: float, limit: float) -> int:
    """The octants, as bits, whose centre o has o.(x, y, z) <= limit."""
    ...


@wp.func
def octants_below(rows: wp.uint64, octants: Octants, cell: Cell, q: wp.vec3, u: wp.vec3):
    """The octants, as bits, some point p of which may have (p - x).u <= 0; x is at q from the block's centre."""
    room = ROOM * (sum_abs(q) + cell.half[0] + cell.half[1] + cell.half[2])
    limit = wp.dot(q, u) + reach(octants.half, u) + room * sum_abs(u)
    return octants_up_to(rows, u[0], u[1], u[2], limit) & octants.there
