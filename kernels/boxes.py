"""Which octants of a block can a part be nearest to, or which eighths of an octant: by the tests that are noted."""

from __future__ import annotations

import warp as wp

from sdm.kernels.rows import PARTS, TEST_ROW

wp.set_module_options({"enable_backward": False})


@wp.func_native(
    snippet=f"""
    struct alignas(16) Row {{ float x, y, z, w; }};
    const Row* row = reinterpret_cast<const Row*>(rows) + {TEST_ROW} + (pair & {PARTS - 1});
    const unsigned octant = (unsigned)pair / {PARTS};
    // In voxels: half of a box, from box to box, and the middle of the first one.
    const float half = level == 0 ? 1.5f : 0.5f, step = level == 0 ? 4.0f : 2.0f;
    const float other = half + 4.0f;
    const float a = octant & 4 ? other : half, b = octant & 2 ? other : half, c = octant & 1 ? other : half;
#if defined(__CUDA_ARCH__)
    unsigned dropped = 0;
    const Row* const end = row + {PARTS} * tests;
    #pragma unroll 1
    do {{
        const Row u = *row;
        const float reach = half * (fabsf(u.x) + fabsf(u.y) + fabsf(u.z));
        const float left = u.w + reach - (a * u.x + b * u.y + c * u.z);
        const float di = step * u.x, dj = step * u.y, dk = step * u.z;
        // Their signs, in two chains: each step waits for the one before.
        unsigned below = 0, above = 0;
        #pragma unroll
        for (int e = 3; e >= 0; --e) {{
            const float at = left - (e & 2 ? dj : 0.0f) - (e & 1 ? dk : 0.0f);
            below = __funnelshift_l(__float_as_uint(at), below, 1);
            above = __funnelshift_l(__float_as_uint(at - di), above, 1);
        }}
        dropped |= (above << 4) + below;
        row += {PARTS};
    }} while (row < end);
    return 255 & ~dropped;
#else
    // The same, all boxes in one vector.
    typedef float Eight __attribute__((ext_vector_type(8)));
    typedef int Mask __attribute__((ext_vector_type(8)));
    const Eight is = {{0, 0, 0, 0, step, step, step, step}}, js = {{0, 0, step, step, 0, 0, step, step}};
    const Eight ks = {{0, step, 0, step, 0, step, 0, step}};
    Mask dropped = 0;
    for (int test = 0; test < tests; ++test) {{
        const Row u = row[{PARTS} * test];
        const float reach = half * (fabsf(u.x) + fabsf(u.y) + fabsf(u.z));
        const Eight at = u.w + reach - (a * u.x + b * u.y + c * u.z) - is * u.x - js * u.y - ks * u.z;
        dropped |= at < 0.0f;
        // Most parts fail one of the first tests.
        if (test == 1 && __builtin_reduce_and(dropped)) return 0;
    }}
    const Mask bits = {{1, 2, 4, 8, 16, 32, 64, 128}};
    return __builtin_reduce_or(~dropped & bits);
#endif
"""
)
def boxes_of(rows: wp.uint64, pair: int, level: int, tests: int) -> int:
    """The boxes, as bits, that pass all the tests of a part.

    On level 0 the octants of the block, on level 1 the eighths of the octant of a pair, see `queues`.
    """
    ...
