"""Which octants of a block can a part be nearest to, and which eighths of an octant: by the tests that are noted."""

from __future__ import annotations

import warp as wp

from sdm.kernels.dense.block.shared_layout import LATTICE_ROW, PARTS, TEST_ROW

wp.set_module_options({"enable_backward": False})

_ROW = "struct alignas(16) Row { float x, y, z, w; };"


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


@wp.func_native(
    snippet=f"""
    {_ROW}
    const Row* lattice = reinterpret_cast<const Row*>(rows) + {LATTICE_ROW};
    const Row o = lattice[0], i = lattice[1], j = lattice[2], k = lattice[3];
    Row* row = reinterpret_cast<Row*>(rows) + {TEST_ROW} + number;
    unsigned dropped = 0;
    // Not written out several times: code that does not fit into a GPU's cache has to be waited for.
    #pragma unroll 1
    for (; tests > 0; --tests, row += {PARTS}) {{
        const Row v = *row;
        const float wider = o.w * (fabsf(v.x) + fabsf(v.y) + fabsf(v.z));
        Row u = {{i.x * v.x + i.y * v.y + i.z * v.z, j.x * v.x + j.y * v.y + j.z * v.z,
                 k.x * v.x + k.y * v.y + k.z * v.z, v.w + wider - (o.x * v.x + o.y * v.y + o.z * v.z)}};
        // The least value of two voxels along each axis is so much less than that of the first; of four, three times.
        const float less = 0.5f * (fabsf(u.x) + fabsf(u.y) + fabsf(u.z) - (u.x + u.y + u.z));
        u.w += less;
        const float left = u.w + 2.0f * less;
        *row = u;
        {_eight(4.0)}
    }}
    return 255 & ~dropped;
"""
)
def octants_of(rows: wp.uint64, number: int, tests: int) -> int:
    """The octants of the block, as bits, that pass all the tests of a part.

    These are written anew, in steps of the lattice from its first voxel, as `eighths_of` wants them.
    """
    ...


@wp.func_native(
    snippet=f"""
    {_ROW}
    const Row* row = reinterpret_cast<const Row*>(rows) + {TEST_ROW} + (pair & {PARTS - 1});
    const Row* const end = row + {PARTS} * tests;
    const unsigned octant = (unsigned)pair / {PARTS};
    const float a = octant & 4 ? 4.0f : 0.0f, b = octant & 2 ? 4.0f : 0.0f, c = octant & 1 ? 4.0f : 0.0f;
    unsigned dropped = 0;
    #pragma unroll 1
    do {{
        const Row u = *row;
        const float left = u.w - a * u.x - b * u.y - c * u.z;
        {_eight(2.0)}
        row += {PARTS};
    }} while (row < end);
    return 255 & ~dropped;
"""
)
def eighths_of(rows: wp.uint64, pair: int, tests: int) -> int:
    """The eighths of the octant of a pair (see `queues`), as bits, that pass all the tests of its part."""
    ...
