"""Octant tests: the octants of a block that a feature can be nearest to, and the eighths of those.

A block of 8^3 voxels has eight octants of 4^3, each of which has eight eighths of 2^3. Features that matter to the
block are worked out once, for its centre, and measured where they matter. That is asked as for the block in
`voronoi_features`: x being the point of the surface that is nearest to p, (p - x).u <= 0 for certain directions u of
each feature, and no feature matters to a box of which no point fulfils one of these inequalities.

For a box with half-widths h around o, both from the block's centre, and x at q from there, the least (p - x).u is
o.u - q.u - sum_i h_i |u_i|, so that o.u is compared with q.u and what u and the box's size add to it.

And no feature matters to a box for all of whose voxels p the block's witness y is nearer than x. Here x is a corner, or
lies inside an edge or a face, with p - x at right angles to that. Then |p - x|^2 is |p - g|^2 - |x - g|^2 for any other
point g of it, and |x - g| is at most the distance r from g to its corners. So with g at q, the feature can be nearer
only if |p - g|^2 - r^2 <= |p - y|^2, which is linear in p, as the square of p cancels: 2 p.(y - q) <= |y|^2 - |q|^2 +
r^2. That is of the same form: the row of a test is (u, what o.u may be up to). g is the corner, with r = 0, the middle
of the edge, or the mean of the face's corners.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.culling.voronoi_features import ROOM
from sdm.kernels.culling.witness_bound import Witness, doubt, sum_abs
from sdm.kernels.dense.block.shared_layout import BATCH, LATTICE_ROW, TEST_ROW, WITNESS_ROW, read_row, write_row
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.geometry.voxel_grid import Slab, way
from sdm.kernels.primitives.fast_math import FUSED

wp.set_module_options({"enable_backward": False})

# How much wider an octant may be than the first for rounding of its voxels' coordinates, in units of those.
WIDER = 5.0e-7

_ROW = "struct alignas(16) Row { float x, y, z, w; };"


@wp.func
def octants_in_slab(slab: Slab, start: wp.vec3i, bits: int):
    """The octants of a block, as bits, that have voxels. One of 4^3 voxels has the first alone."""
    # The bits of octants on the far side of an axis go where that side has no voxels.
    there = int(255)
    if start[0] + 4 >= slab.shape[0]:
        there = there & 15
    if start[1] + 4 >= slab.shape[1]:
        there = there & 51
    if start[2] + 4 >= slab.shape[2]:
        there = there & 85
    return wp.where(bits == 2, 1, there)


@wp.func
def write_lattice(
    slab: Slab, scratch: wp.uint64, start: wp.vec3i, box: VoxelBox, scale: wp.float64, lane: int, lanes: int
):
    """Write where a block's first voxel is, from its centre, and the steps from there to the next ones.

    And in the fourth place of each, how far rounding may have put a voxel aside.
    """
    row = lane
    while row < 4:
        # Not by a number into a vector, which would be in memory.
        steps = wp.vec3d(wp.float64(int(row == 1)), wp.float64(int(row == 2)), wp.float64(int(row == 3)))
        if row == 0:
            steps = wp.vec3d(wp.float64(start[0] + slab.first), wp.float64(start[1]), wp.float64(start[2]))
        at = way(slab, steps)
        if row == 0:
            at = at + slab.origin
        at = scale * at
        if row == 0:
            at = at - wp.vec3d(box.centre)
        wider = WIDER * (
            wp.max(wp.vec3(wp.abs(box.centre[0]), wp.abs(box.centre[1]), wp.abs(box.centre[2])) + box.half)
        )
        write_row(scratch, LATTICE_ROW + row, float(at[0]), float(at[1]), float(at[2]), wider)
        row = row + lanes


@wp.func
def write_block_witness(scratch: wp.uint64, box: VoxelBox, known: Witness, lane: int):
    """Note a block's witness, seen from its centre, and its square with room for rounding."""
    if lane == 0:
        u = known.to_surface
        write_row(scratch, WITNESS_ROW, -u[0], -u[1], -u[2], known.distance2 + doubt(box, known))


@wp.func
def write_test(scratch: wp.uint64, test: int, number: int, u: wp.vec3, most: float):
    """Write test `test` of feature `number`: may some point p of a box, from the block's centre, have p.u <= most?

    `octants_of` then writes it so that boxes are found by adding.
    """
    write_row(scratch, TEST_ROW + BATCH * test + number, u[0], u[1], u[2], most)


@wp.func
def test_direction(scratch: wp.uint64, test: int, number: int, room: float, q: wp.vec3, u: wp.vec3):
    """Write the test of a direction: may some point p have (p - x).u <= 0? x is at q from the block's centre."""
    write_test(scratch, test, number, u, wp.dot(q, u) + room * sum_abs(u))


@wp.func
def test_witness(scratch: wp.uint64, test: int, number: int, q: wp.vec3, radius2: float):
    """Write the test of the witness: may a feature, within a ball around q, be nearer to a voxel than that?"""
    witness = read_row(scratch, WITNESS_ROW)
    gap = wp.vec3(witness[0], witness[1], witness[2]) - q
    write_test(scratch, test, number, gap, 0.5 * (witness[3] + radius2 - wp.dot(q, q)))


@wp.func
def room_for(box: VoxelBox, q: wp.vec3):
    """Room for rounding in the directions from a point at q, in units of their lengths."""
    return ROOM * (sum_abs(q) + box.half[0] + box.half[1] + box.half[2])


def _eight(step: float) -> str:
    """Native text: which of eight boxes fail the test `u`, in steps of the lattice, into `dropped`.

    They are `step` voxels apart; in the first, the least value is `left` below the test's limit.
    """
    return f"""
#if defined(__CUDA_ARCH__)
        const float di = {step}f * u.x, dj = {step}f * u.y, dk = {step}f * u.z;
        // Their signs, in two chains: each step waits for the one before.
        unsigned below = 0, above = 0;
        #pragma unroll
        for (int e = 3; e >= 0; --e) {{
            const float at = left - (e & 2 ? dj : 0.0f) - (e & 1 ? dk : 0.0f);
            below = __funnelshift_l(__float_as_uint(at), below, 1);
            above = __funnelshift_l(__float_as_uint(at - di), above, 1);
        }}
        dropped |= (above << 4) + below;
#else
        // The same, all boxes in one vector.
        typedef float Eight __attribute__((ext_vector_type(8)));
        typedef int Mask __attribute__((ext_vector_type(8)));
        const float s = {step}f;
        const Eight is = {{0, 0, 0, 0, s, s, s, s}}, js = {{0, 0, s, s, 0, 0, s, s}}, ks = {{0, s, 0, s, 0, s, 0, s}};
        const Mask bits = {{1, 2, 4, 8, 16, 32, 64, 128}};
        dropped |= __builtin_reduce_or((left - is * u.x - js * u.y - ks * u.z < 0.0f) & bits);
        if (dropped == 255) return 0;
#endif
"""


def _first_boxes(step: float, keep: str) -> str:
    """Native text: which of eight boxes of so many voxels along each axis pass all tests of a feature.

    `keep`: what is done with a test in steps of the lattice, whose limit has room for two voxels along each axis.
    """
    return f"""
    {FUSED}
    {_ROW}
    const Row* lattice = reinterpret_cast<const Row*>(scratch) + {LATTICE_ROW};
    const Row o = lattice[0], i = lattice[1], j = lattice[2], k = lattice[3];
    Row* row = reinterpret_cast<Row*>(scratch) + {TEST_ROW} + number;
    unsigned dropped = 0;
    // Not written out several times: code that does not fit into a GPU's cache has to be waited for.
    #pragma unroll 1
    for (; tests > 0; --tests, row += {BATCH}) {{
        const Row v = *row;
        const float wider = o.w * (fabsf(v.x) + fabsf(v.y) + fabsf(v.z));
        Row u = {{FUSED(i.z, v.z, FUSED(i.y, v.y, i.x * v.x)), FUSED(j.z, v.z, FUSED(j.y, v.y, j.x * v.x)),
                 FUSED(k.z, v.z, FUSED(k.y, v.y, k.x * v.x)),
                 v.w + wider - FUSED(o.z, v.z, FUSED(o.y, v.y, o.x * v.x))}};
        // The least value of two voxels along each axis is so much less than that of the first; of four, three times.
        const float less = 0.5f * (fabsf(u.x) + fabsf(u.y) + fabsf(u.z) - (u.x + u.y + u.z));
        u.w += less;
        const float left = u.w + {step - 2.0}f * less;
        {keep}
        {_eight(step)}
    }}
    return 255 & ~dropped;
"""


@wp.func_native(snippet=_first_boxes(4.0, "*row = u;"))
def octants_of(scratch: wp.uint64, number: int, tests: int) -> int:
    """The octants of the block, as bits, that pass all the tests of a feature.

    These are written anew, in steps of the lattice from its first voxel, as `eighths_of` wants them.
    """
    ...


@wp.func_native(snippet=_first_boxes(8.0, ""))
def bricks_of(scratch: wp.uint64, number: int, tests: int) -> int:
    """The bricks of 8^3 voxels of a cell of 16^3, as bits, that pass all the tests of a feature."""
    ...


@wp.func_native(
    snippet=f"""
    {FUSED}
    {_ROW}
    const Row* row = reinterpret_cast<const Row*>(scratch) + {TEST_ROW} + (pair & {BATCH - 1});
    const Row* const end = row + {BATCH} * tests;
    const unsigned octant = (unsigned)pair / {BATCH};
    const float a = octant & 4 ? 4.0f : 0.0f, b = octant & 2 ? 4.0f : 0.0f, c = octant & 1 ? 4.0f : 0.0f;
    unsigned dropped = 0;
    #pragma unroll 1
    do {{
        const Row u = *row;
        const float left = FUSED(-c, u.z, FUSED(-b, u.y, FUSED(-a, u.x, u.w)));
        {_eight(2.0)}
        row += {BATCH};
    }} while (row < end);
    return 255 & ~dropped;
"""
)
def eighths_of(scratch: wp.uint64, pair: int, tests: int) -> int:
    """The eighths of the octant of a pair (see `work_queues`), as bits, that pass all the tests of its feature."""
    ...
