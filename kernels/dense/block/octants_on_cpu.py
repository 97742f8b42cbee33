"""Measuring of one feature in a block's octants on a CPU, eight voxels at once.

As `octant_tests` and `min_values` have it, bit for bit, but without queues, which are for lanes that share work; and
without a branch between tests, as a CPU guesses wrong which of them fails.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.dense.block.min_values import CORNER_TEXT, FACE_TEXT, FAR_EDGE_TEXT, NEAR_EDGE_TEXT
from sdm.kernels.dense.block.shared_layout import BATCH, COORDINATES, LATTICE_ROW, MIN_VALUES, TEST_ROW
from sdm.kernels.dense.block.winners import BlockOutput
from sdm.kernels.primitives.fast_math import FUSED

wp.set_module_options({"enable_backward": False})


def _measure(feature: tuple[str, str]) -> str:
    """Native text that measures a feature in the eighths `there`: that of one voxel, with eight numbers in the place of
    one.
    """
    rows, own = feature
    for one, eight in (("const float ", "const T "), ("const bool counts = true;", ""), ("const bool ", "const M ")):
        own = own.replace(one, eight)
    own = own.replace("!(", "~(")
    counts = "" if feature is CORNER_TEXT else "least = counts ? least : known;"
    return f"""{{
        {rows}
        for (unsigned left = there; left; left &= left - 1) {{
            const int in = __builtin_ctz(left);
            const T x = xs[in >> 2], y = ys[in >> 1 & 1], z = zs[in & 1];
            T known;
            __builtin_memcpy(&known, best + 8 * in, 32);
            {own}
            T least = d < known ? d : known;
            {counts}
            __builtin_memcpy(best + 8 * in, &least, 32);
        }}
    }}"""


# Which of eight boxes, so many voxels apart, pass all tests, as bits.
_PASSED = """
    auto passed = [&](const float* limits, float s) {
        const T is = {0, 0, 0, 0, s, s, s, s}, js = {0, 0, s, s, 0, 0, s, s}, ks = {0, s, 0, s, 0, s, 0, s};
        M failed = {};
        #pragma unroll
        for (int t = 0; t < 6; ++t)
            if (t < tests) failed |= limits[t] - is * ux[t] - js * uy[t] - ks * uz[t] < 0.0f;
        return 255u & ~(unsigned)__builtin_bit_cast(unsigned char, __builtin_convertvector(failed, Bits));
    };
"""


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {FUSED}
    typedef float T __attribute__((ext_vector_type(8)));
    typedef int M __attribute__((ext_vector_type(8)));
    typedef bool Bits __attribute__((ext_vector_type(8)));
    struct alignas(16) Row {{ float x, y, z, w; }};
    const Row* row = reinterpret_cast<const Row*>(scratch);
    const float* number = reinterpret_cast<const float*>(scratch);
    const int feature = 0, tests = 6 - kind;
    const float a = near ? 1.0f : 0.0f, b = 2.0f - a;
    const Row o = row[{LATTICE_ROW}], i = row[{LATTICE_ROW + 1}], j = row[{LATTICE_ROW + 2}];
    const Row k = row[{LATTICE_ROW + 3}];
    // The tests in steps of the lattice, all at once: see `octants_of`.
    const Row* test = row + {TEST_ROW};
    T vx, vy, vz, vw;
    #pragma unroll
    for (int t = 0; t < 8; ++t) {{
        const Row v = test[{BATCH} * (t < 6 ? t : 0)];
        vx[t] = v.x; vy[t] = v.y; vz[t] = v.z; vw[t] = v.w;
    }}
    auto size_of = [](T x) {{ return (T)((M)x & 0x7fffffff); }};
    const T wider = o.w * (size_of(vx) + size_of(vy) + size_of(vz));
    const T tx = FUSED(i.z, vz, FUSED(i.y, vy, i.x * vx)), ty = FUSED(j.z, vz, FUSED(j.y, vy, j.x * vx));
    const T tz = FUSED(k.z, vz, FUSED(k.y, vy, k.x * vx));
    const T less = 0.5f * (size_of(tx) + size_of(ty) + size_of(tz) - (tx + ty + tz));
    const T tw = vw + wider - FUSED(o.z, vz, FUSED(o.y, vy, o.x * vx)) + less, tleft = tw + 2.0f * less;
    float ux[8], uy[8], uz[8], lefts[8];
    __builtin_memcpy(ux, &tx, 32);
    __builtin_memcpy(uy, &ty, 32);
    __builtin_memcpy(uz, &tz, 32);
    __builtin_memcpy(lefts, &tleft, 32);
    {_PASSED}
    for (unsigned some = passed(lefts, 4.0f) & octants; some; some &= some - 1) {{
        const unsigned octant = __builtin_ctz(some);
        const float fa = octant & 4 ? 4.0f : 0.0f, fb = octant & 2 ? 4.0f : 0.0f, fc = octant & 1 ? 4.0f : 0.0f;
        const T inner = FUSED(-fc, tz, FUSED(-fb, ty, FUSED(-fa, tx, tw)));
        float limits[8];
        __builtin_memcpy(limits, &inner, 32);
        const unsigned there = passed(limits, 2.0f);
        float* __restrict best = reinterpret_cast<float*>(scratch) + {MIN_VALUES} + 64 * octant;
        T xs[2], ys[2], zs[2];
        for (int side = 0; side < 2; ++side) {{
            const float* p = number + {COORDINATES} + (octant & 4) + 2 * side;
            const float* q = number + {COORDINATES + 8} + (octant << 1 & 4) + 2 * side;
            const float* r = number + {COORDINATES + 16} + (octant << 2 & 4) + 2 * side;
            xs[side] = T{{p[0], p[0], p[0], p[0], p[1], p[1], p[1], p[1]}};
            ys[side] = T{{q[0], q[0], q[1], q[1], q[0], q[0], q[1], q[1]}};
            zs[side] = T{{r[0], r[1], r[0], r[1], r[0], r[1], r[0], r[1]}};
        }}
        if (kind == 0) {_measure(CORNER_TEXT)}
        else if (kind == 1 && near) {_measure(NEAR_EDGE_TEXT)}
        else if (kind == 1) {_measure(FAR_EDGE_TEXT)}
        else {_measure(FACE_TEXT)}
    }}
#endif
"""
)
def measure_octants(scratch: wp.uint64, kind: int, octants: int, room: float, near: bool):
    """Lessen the values of voxels of the block's `octants` (bits), on a grid along x, y and z, to those of the feature
    of this kind whose rows are the first.
    """
    ...


@wp.func
def by_octants(winners: int):
    """True if values alone are wanted."""
    return True


@wp.func
def by_octants(winners: BlockOutput):  # noqa: F811
    return True


@wp.func
def by_octants(winners: wp.array(dtype=wp.int32)):  # noqa: F811
    return False
