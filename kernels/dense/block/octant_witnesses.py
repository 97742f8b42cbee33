"""Witnesses of a block's octants on a CPU, and how far the surface is from their eighths at most.

In the place of the block's witness each octant has one of its own, a point of the listed triangles near its middle: see
`octant_tests`, whose test it is. Where many features are about as far as the surface (loose triangles, sheets through
each other) the directions of `voronoi_features` say little, and this leaves a third.

What large triangles may be nearer than says little for the ball around them. So no voxel of an eighth is further from
the surface than its middle is from the witness and half its diagonal; once features have been measured, than the
largest of its values. Near the surface a face whose plane, and an edge whose line, is further than that from all the
eighth is dropped. As these distances are taken from the rows that measure the feature, no value changes.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.culling.witness_bound import LARGEST_SQUARE, OFF_SURFACE, SLACK
from sdm.kernels.dense.block.shared_layout import BATCH, COORDINATES, PAIRS

wp.set_module_options({"enable_backward": False})

# Numbers of eight octants, in the place of the queues: their witnesses, the square of how far these are from their
# middles, half of what a witness beats; then their middles and half-widths; and those of eighths in either half of a
# block, and where their voxels are.
AT = PAIRS // 4
WITNESS, SQUARE, LIMIT, MIDDLE, HALF = AT, AT + 24, AT + 32, AT + 40, AT + 64
EIGHTH, VOXEL = AT + 88, AT + 184
# In the place of other features' rows: how far the surface is at most from all voxels of each eighth, and of each
# octant; how many features have been measured in an octant, after every so many of which that is looked at again; and
# the squares of how far eighths' middles, and those of octants, may be from an edge.
REACH, OCTANT_REACH, MEASURED = 32, 96, 104
LINE_REACH, OCTANT_LINE_REACH = 4 * BATCH + 32, 4 * BATCH + 96
AFRESH = 32
# What rounding may add to that, in parts of it, and of the block's half-widths.
FARTHER = 1.0e-5

OCTANT_TYPES = """
    typedef float T __attribute__((ext_vector_type(8)));
    typedef int M __attribute__((ext_vector_type(8)));
    typedef bool Bits __attribute__((ext_vector_type(8)));
    float* const number = reinterpret_cast<float*>(scratch);
    auto load = [&](int at) { T x; __builtin_memcpy(&x, number + at, 32); return x; };
    auto keep = [&](int at, T x) { __builtin_memcpy(number + at, &x, 32); };
    auto size_of = [](T x) { return (T)((M)x & 0x7fffffff); };
    auto root = [](T x) { for (int k = 0; k < 8; ++k) x[k] = __builtin_sqrtf(x[k]); return x; };
    auto bits_of = [](M m) {
        return (int)__builtin_bit_cast(unsigned char, __builtin_convertvector(m, Bits));
    };
"""


# Keeps how far the surface is at most from the voxels of an octant's eighths.
KEEP_REACH = f"""
    auto keep_reach = [&](int octant, T reach) {{
        T half2 = {{}}, octant2 = {{}};
        for (int axis = 0; axis < 3; ++axis) {{
            const T half = load({EIGHTH} + 32 * axis + (octant >> (2 - axis) & 1) * 16 + 8);
            half2 += half * half;
            octant2 += load({HALF} + 8 * axis) * load({HALF} + 8 * axis);
        }}
        keep({REACH} + 8 * octant, reach);
        const T line = (reach + root(half2)) * (reach + root(half2));
        keep({LINE_REACH} + 8 * octant, line);
        const float most = __builtin_reduce_max(reach), whole = most + root(octant2)[octant];
        number[{OCTANT_REACH} + octant] = most;
        number[{OCTANT_LINE_REACH} + octant] = whole * whole;
    }};
"""


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {OCTANT_TYPES}
    const float* const x = number + {COORDINATES};
    const float* const y = x + 8;
    const float* const z = x + 16;
    // A rounding more than the voxels need, so that none sticks out.
    auto keep_box = [&](int middle, int half, T low, T high) {{
        keep(middle, 0.5f * (low + high));
        keep(half, 0.500001f * (high - low));
    }};
    auto along_x = [](float a, float b) {{ return T{{a, a, a, a, b, b, b, b}}; }};
    auto along_y = [](float a, float b) {{ return T{{a, a, b, b, a, a, b, b}}; }};
    auto along_z = [](float a, float b) {{ return T{{a, b, a, b, a, b, a, b}}; }};
    keep_box({MIDDLE}, {HALF}, along_x(x[0], x[4]), along_x(x[3], x[7]));
    keep_box({MIDDLE + 8}, {HALF + 8}, along_y(y[0], y[4]), along_y(y[3], y[7]));
    keep_box({MIDDLE + 16}, {HALF + 16}, along_z(z[0], z[4]), along_z(z[3], z[7]));
    for (int half = 0; half < 2; ++half) {{
        const float* p = x + 4 * half;
        const float* q = y + 4 * half;
        const float* r = z + 4 * half;
        const int to = {EIGHTH} + 16 * half, at = {VOXEL} + 16 * half;
        keep_box(to, to + 8, along_x(p[0], p[2]), along_x(p[1], p[3]));
        keep_box(to + 32, to + 40, along_y(q[0], q[2]), along_y(q[1], q[3]));
        keep_box(to + 64, to + 72, along_z(r[0], r[2]), along_z(r[1], r[3]));
        for (int k = 0; k < 2; ++k) {{
            keep(at + 8 * k, along_x(p[2 * k], p[2 * k + 1]));
            keep(at + 32 + 8 * k, along_y(q[2 * k], q[2 * k + 1]));
            keep(at + 64 + 8 * k, along_z(r[2 * k], r[2 * k + 1]));
        }}
    }}
    T square = {{}};
    for (int axis = 0; axis < 3; ++axis) {{
        const T off = load({MIDDLE} + 8 * axis) - witness.c[axis];
        square += off * off;
        keep({WITNESS} + 8 * axis, T{{}} + witness.c[axis]);
    }}
    keep({SQUARE}, square);
#endif
"""
)
def begin_octants(scratch: wp.uint64, witness: wp.vec3):
    """Write where octants, eighths and voxels are, and one witness for all octants, from the block's centre."""
    ...


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {OCTANT_TYPES}
    const float* const corner = reinterpret_cast<const float*>(corners.data) + 12 * (size_t)slot;
    float a[3], b[3], c[3], bb = 0.0f, bc = 0.0f, cc = 0.0f;
    T along_b = {{}}, along_c = {{}}, middle[3];
    for (int axis = 0; axis < 3; ++axis) {{
        a[axis] = corner[axis] - centre.c[axis];
        b[axis] = corner[3 + axis] - corner[axis];
        c[axis] = corner[6 + axis] - corner[axis];
        bb += b[axis] * b[axis];
        bc += b[axis] * c[axis];
        cc += c[axis] * c[axis];
        middle[axis] = load({MIDDLE} + 8 * axis);
        along_b += b[axis] * (middle[axis] - a[axis]);
        along_c += c[axis] * (middle[axis] - a[axis]);
    }}
    const float size = bb * cc - bc * bc, per = size > 0.0f ? 1.0f / size : 0.0f;
    T u = per * (cc * along_b - bc * along_c), v = per * (bb * along_c - bc * along_b);
    u = u > 0.0f ? u : T{{}};
    v = v > 0.0f ? v : T{{}};
    const T sum = u + v, less = 1.0f / (sum > 1.0f ? sum : T{{}} + 1.0f);
    T at[3], square = {{}};
    for (int axis = 0; axis < 3; ++axis) {{
        at[axis] = a[axis] + less * (u * b[axis] + v * c[axis]);
        square += (middle[axis] - at[axis]) * (middle[axis] - at[axis]);
    }}
    const T known = load({SQUARE});
    const M nearer = square < known;
    keep({SQUARE}, nearer ? square : known);
    for (int axis = 0; axis < 3; ++axis) {{
        keep({WITNESS} + 8 * axis, nearer ? at[axis] : load({WITNESS} + 8 * axis));
    }}
#endif
"""
)
def see_triangle(scratch: wp.uint64, corners: wp.array(dtype=wp.vec3), slot: int, centre: wp.vec3):
    """Take a point of a triangle for the witness of the octants to whose middles it is the nearest so far.

    Not the nearest of the triangle where that is on its rim, but one of it, however thin it is.
    """
    ...


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {OCTANT_TYPES}
    const T x = load({WITNESS}), y = load({WITNESS + 8}), z = load({WITNESS + 16});
    const T square = x * x + y * y + z * z, squares = square + half2;
    // As `witness_bound.doubt` has it.
    const T doubt = {SLACK}f * squares + {OFF_SURFACE}f * diagonal * (size_of(x) + size_of(y) + size_of(z) + room);
    keep({LIMIT}, squares < {LARGEST_SQUARE}f ? 0.5f * (square + doubt) : T{{}} + INFINITY);
    const float farther = {FARTHER}f * room;
    keep({MEASURED}, T{{}});
    {KEEP_REACH}
    for (int octant = 0; octant < 8; ++octant) {{
        T away = {{}}, half2 = {{}};
        for (int axis = 0; axis < 3; ++axis) {{
            const int at = {EIGHTH} + 32 * axis + (octant >> (2 - axis) & 1) * 16;
            const T off = load(at) - number[{WITNESS} + 8 * axis + octant];
            away += off * off;
            half2 += load(at + 8) * load(at + 8);
        }}
        keep_reach(octant, (root(away) + root(half2)) * {1.0 + FARTHER}f + farther);
    }}
#endif
"""
)
def end_witnesses(scratch: wp.uint64, half2: float, diagonal: float, room: float):
    """Write what the octants' witnesses beat, and how far the surface is from eighths at most; `room` is the sum of the
    block's half-widths.
    """
    ...


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {OCTANT_TYPES}
    T least = {{}};
    for (int axis = 0; axis < 3; ++axis) {{
        const T gap = load({WITNESS} + 8 * axis) - q.c[axis];
        least += gap * load({MIDDLE} + 8 * axis) - size_of(gap) * load({HALF} + 8 * axis);
    }}
    const float more = 0.5f * (radius2 - (q.c[0] * q.c[0] + q.c[1] * q.c[1] + q.c[2] * q.c[2]));
    return 255 & ~bits_of(least > load({LIMIT}) + more);
#else
    return 0;
#endif
"""
)
def octants_near(scratch: wp.uint64, q: wp.vec3, radius2: float) -> int:
    """The octants, as bits, to some voxel of which a feature within a ball around q may be nearer than the witness."""
    ...
