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
from sdm.kernels.rows import LATTICE_ROW, write_row

wp.set_module_options({"enable_backward": False})

# How much wider an octant may be than the first for rounding of its voxels' coordinates, in units of those.
WIDER = wp.constant(5.0e-7)
_LATTICE_ROW = wp.constant(LATTICE_ROW)


@wp.struct
class Octants:
    """The octants of a block."""

    half: wp.vec3  # half-widths of each
    there: wp.int32  # one bit for each that has voxels


@wp.func
def octants_of(slab: Slab, start: wp.vec3i, bits: int, cell: Cell, scale: wp.float64):
    """The octants of a block (`cell`). One of 4^3 voxels has the first alone."""
    octants = Octants()
    half = wp.vec3(scale * reach_of(slab, wp.vec3d(wp.vec3(1.5, 1.5, 1.5))))
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
    octants.there = wp.where(bits == 2, 1, there)
    return octants


@wp.func
def note_lattice(slab: Slab, rows: wp.uint64, start: wp.vec3i, cell: Cell, scale: wp.float64, lane: int, lanes: int):
    """Note where a block's first voxel is, from its centre, and the steps from there to the next ones."""
    first = wp.vec3d(wp.float64(start[0]), wp.float64(start[1]), wp.float64(start[2]))
    row = lane
    while row < 4:
        # Not by a number into a vector, which would be in memory.
        step = wp.vec3d(wp.float64(int(row == 1)), wp.float64(int(row == 2)), wp.float64(int(row == 3)))
        at = scale * place_of(slab, first + step)
        if row == 0:
            at = at - wp.vec3d(cell.centre)
        else:
            at = at - scale * place_of(slab, first)
        write_row(rows, _LATTICE_ROW + row, float(at[0]), float(at[1]), float(at[2]), 0.0)
        row = row + lanes


@wp.func_native(
    snippet=f"""
    struct alignas(16) Row {{ float x, y, z, w; }};
    const Row* row = reinterpret_cast<const Row*>(rows) + {LATTICE_ROW};
    const float i = row[1].x * x + row[1].y * y + row[1].z * z, j = row[2].x * x + row[2].y * y + row[2].z * z;
    const float k = row[3].x * x + row[3].y * y + row[3].z * z;
    // The middle of the first four voxels along each axis.
    const float first = row[0].x * x + row[0].y * y + row[0].z * z + 1.5f * (i + j + k);
    int found = 0;
    for (int o = 0; o < 8; ++o) {{
        const float at = first + (o & 4 ? 4.0f * i : 0.0f) + (o & 2 ? 4.0f * j : 0.0f) + (o & 1 ? 4.0f * k : 0.0f);
        found |= (int)(at <= limit) << o;
    }}
    return found;
"""
)
def octants_up_to(rows: wp.uint64, x: float, y: float, z: float, limit: float) -> int:
    """The octants, as bits, whose centre o has o.(x, y, z) <= limit. The block's lattice is noted in the rows."""
    ...


@wp.func
def octants_below(rows: wp.uint64, octants: Octants, cell: Cell, q: wp.vec3, u: wp.vec3):
    """The octants, as bits, some point p of which may have (p - x).u <= 0; x is at q from the block's centre."""
    room = ROOM * (sum_abs(q) + cell.half[0] + cell.half[1] + cell.half[2])
    limit = wp.dot(q, u) + reach(octants.half, u) + room * sum_abs(u)
    return octants_up_to(rows, u[0], u[1], u[2], limit) & octants.there
