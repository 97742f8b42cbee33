"""Fields of far edges that a box of 8^3 voxels hands down to its octants, on a CPU.

A polynomial of strips swept away from a box's centre is of no use about another one. But its gradient is that of the
edges alone (the law of Biot and Savart): at y from the centre an edge from a to b adds

    F(y) = (a x b - y x e) (S + s.y + y.H y/2 + ...),   e = b - a

with S, s and H as `cap_taylor` has them, and the strips swept away from any place h are what F adds up to on the
straight way from h to a voxel. So F up to the second order, 30 numbers, is kept for the box; for an octant, whose
centre is at h, the strips' share of the centre is that on the way there,

    h.(F0 + F1 h/2 + F2(h)/3),   and its polynomial   z.(F(h) + DF(h) z/2 + F2(z)/3),

where the last is the box's own, as z.(z x e) is none.

Errors. A term of order m of F is at most (m + 1) l |y|^m / d^(m + 2), see `cap_field`. On the way from the centre to h
and on to a voxel at h + z, where |h| + |z| is no more than the radius R, these add up to l/d (R/d)^(m + 1): the bound
is that of the box's own polynomial. That holds for whole boxes, where h is 2 and z up to 1.5 voxels
along each axis, within the 2 % that are added for centres that are a little aside.
Rounding is in proportion to |a x b| + R l in the place of |a x b|, and y x e, which is at most R l <= |a| l / 2, is
wrong by the share of S and s, (6 K + 12) u; K is more than one only where the foot of the line is within the edge,
whence R l <= |a x b| / 2.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.wide_numbers import SIXTEEN, WIDEST_NUMBERS
from sdm.kernels.winding.eights.packed_edges import (
    ADD,
    BEGIN_SUMS,
    EDGES,
    END_SUMS,
    FAR,
    LISTS,
    LOOK_ALONE,
    MET,
    ROW,
    TURN,
)
from sdm.kernels.winding.near_caps import UNIT
from sdm.kernels.winding.rims.radial_strips import (
    ACROSS_BOX,
    CUBES,
    DRIFT,
    ERROR,
    NEAR,
    PRODUCTS,
    SHARE,
    SHARE_ERROR,
    SLOPE,
    SQUARES,
    STEPS,
    SUMS_OF_LOOK,
    Look,
)

wp.set_module_options({"enable_backward": False})

# Places in a large look: F(0); what it changes by along each axis; what that changes by, for each axis of F by xx, yy,
# zz, xy, xz and yz; and what a look has behind its polynomial.
FIRST, SECOND, THIRD, REST = 0, 3, 12, 30
LargeLook = wp.types.vector(length=37, dtype=wp.float32)
FOUND_NEAR, FOUND_ACROSS = REST + 4, REST + 5
_REST = (ERROR, DRIFT, SHARE, SHARE_ERROR, NEAR, ACROSS_BOX, STEPS)


@wp.func_native(
    snippet=f"""
    {WIDEST_NUMBERS}
    wp::vec_t<37, float> found;
#if !defined(__CUDA_ARCH__)
    {BEGIN_SUMS}
    T bounds = none, drift = none, steps = none, f0[3], f1[9], f2[18];
    for (int k = 0; k < 3; ++k) f0[k] = none;
    for (int k = 0; k < 9; ++k) f1[k] = none;
    for (int k = 0; k < 18; ++k) f2[k] = none;
    int near = 0, across = 0;
    const float cube = radius * radius * radius / 3.0f, square = radius * radius;
    const float room_y = half.c[1] * 1.0001f, room_z = half.c[2] * 1.0001f;
    for (int i = 0; WIDE * i < count; ++i) {{
        {EDGES}
        {TURN}
        {FAR}
            const T gone = flat + radius * length;
            const T off = change * (30.0f * fla * length + flat * (30.0f * pair * ik + 40.0f)) + 2.0f * reach * per_d;
            drift = drift + where(far, part * change * gone, none);
            bounds = bounds + where(far, part * ({1.02}f * bound + {UNIT}f * off), none);
            steps = steps + where(far, one, none);
            const T dx = part * ex, dy = part * ey, dz = part * ez;
            f0[0] = f0[0] + s1 * fx;
            f0[1] = f0[1] + s1 * fy;
            f0[2] = f0[2] + s1 * fz;
            f1[0] = f1[0] + fx * sx;
            f1[1] = f1[1] + fx * sy - dz * s1;
            f1[2] = f1[2] + fx * sz + dy * s1;
            f1[3] = f1[3] + fy * sx + dz * s1;
            f1[4] = f1[4] + fy * sy;
            f1[5] = f1[5] + fy * sz - dx * s1;
            f1[6] = f1[6] + fz * sx - dy * s1;
            f1[7] = f1[7] + fz * sy + dx * s1;
            f1[8] = f1[8] + fz * sz;
            const T bend[6] = {{0.5f * xx, 0.5f * yy, 0.5f * zz, 0.5f * xy, 0.5f * xz, 0.5f * yz2}};
            for (int k = 0; k < 6; ++k) {{
                f2[k] = f2[k] + fx * bend[k];
                f2[6 + k] = f2[6 + k] + fy * bend[k];
                f2[12 + k] = f2[12 + k] + fz * bend[k];
            }}
            f2[1] = f2[1] - dz * sy;
            f2[2] = f2[2] + dy * sz;
            f2[3] = f2[3] - dz * sx;
            f2[4] = f2[4] + dy * sx;
            f2[5] = f2[5] - dz * sz + dy * sy;
            f2[6] = f2[6] + dz * sx;
            f2[8] = f2[8] - dx * sz;
            f2[9] = f2[9] + dz * sy;
            f2[10] = f2[10] - dx * sx + dz * sz;
            f2[11] = f2[11] - dx * sy;
            f2[12] = f2[12] - dy * sx;
            f2[13] = f2[13] + dx * sy;
            f2[15] = f2[15] - dy * sy + dx * sx;
            f2[16] = f2[16] - dy * sz;
            f2[17] = f2[17] + dx * sz;
        }}
        {MET}
        {LISTS}
    }}
    {END_SUMS}
    auto total = [&](T x) {{ float s = 0.0f; for (int k = 0; k < WIDE; ++k) s += x[k]; return s; }};
    for (int k = 0; k < 3; ++k) found.c[{FIRST} + k] = total(f0[k]);
    for (int k = 0; k < 9; ++k) found.c[{SECOND} + k] = total(f1[k]);
    for (int k = 0; k < 18; ++k) found.c[{THIRD} + k] = total(f2[k]);
    const float rest[7] = {{total(bounds), total(drift), share, off, (float)near, (float)across, total(steps)}};
    for (int k = 0; k < 7; ++k) found.c[{REST} + k] = rest[k];
#endif
    return found;
"""
)
def look_at_large(
    rows: wp.array(dtype=wp.float32),
    first: int,
    count: int,
    c: wp.vec3,
    radius: float,
    half: wp.vec3,
    tolerance: float,
    stack: wp.array(dtype=wp.int32),
    near_at: int,
    room: int,
    across_at: int,
    room_across: int,
) -> LargeLook:
    """`look_at_eights` with what can be handed down in the place of the polynomial."""
    ...


@wp.func_native(
    snippet=f"""
    wp::vec_t<23, float> found;
#if !defined(__CUDA_ARCH__)
    const float* const f0 = large.c + {FIRST};
    const float* const f1 = large.c + {SECOND};
    const float* const f2 = large.c + {THIRD};
    const float x = h.c[0], y = h.c[1], z = h.c[2];
    float value = 0.0f, slope[3], change[3][3];
    for (int i = 0; i < 3; ++i) {{
        const float* const c = f2 + 6 * i;
        const float linear = f1[3 * i] * x + f1[3 * i + 1] * y + f1[3 * i + 2] * z;
        const float dx = 2.0f * c[0] * x + c[3] * y + c[4] * z;
        const float dy = 2.0f * c[1] * y + c[3] * x + c[5] * z;
        const float dz = 2.0f * c[2] * z + c[4] * x + c[5] * y;
        const float curved = 0.5f * (dx * x + dy * y + dz * z);
        value += h.c[i] * (f0[i] + 0.5f * linear + curved / 3.0f);
        slope[i] = f0[i] + linear + curved;
        change[i][0] = f1[3 * i] + dx;
        change[i][1] = f1[3 * i + 1] + dy;
        change[i][2] = f1[3 * i + 2] + dz;
    }}
    const float rest[7] = {{
        large.c[{REST}], large.c[{REST + 1}], large.c[{REST + 2}] + value * {1.0 / (4.0 * wp.PI)}f,
        large.c[{REST + 3}], 0.0f, 0.0f, large.c[{REST + 6}],
    }};
    for (int k = 0; k < 3; ++k) {{
        found.c[{SLOPE} + k] = slope[k];
        found.c[{SQUARES} + k] = 0.5f * change[k][k];
    }}
    found.c[{PRODUCTS}] = 0.5f * (change[0][1] + change[1][0]);
    found.c[{PRODUCTS} + 1] = 0.5f * (change[0][2] + change[2][0]);
    found.c[{PRODUCTS} + 2] = 0.5f * (change[1][2] + change[2][1]);
    const float third = 1.0f / 3.0f;
    found.c[{CUBES}] = third * f2[0];
    found.c[{CUBES} + 1] = third * (f2[3] + f2[6]);
    found.c[{CUBES} + 2] = third * (f2[4] + f2[12]);
    found.c[{CUBES} + 3] = third * (f2[1] + f2[9]);
    found.c[{CUBES} + 4] = third * (f2[5] + f2[10] + f2[15]);
    found.c[{CUBES} + 5] = third * f2[7];
    found.c[{CUBES} + 6] = third * (f2[11] + f2[13]);
    const int at[7] = {{{", ".join(str(place) for place in _REST)}}};
    for (int k = 0; k < 7; ++k) found.c[at[k]] = rest[k];
#endif
    return found;
"""
)
def handed_down(large: LargeLook, h: wp.vec3) -> Look:
    """The look at a place at h from the centre of a large one, without what is near or across there."""
    ...


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    float* to = kept.data + kept_at;
    auto copy = [&](int list_at, int length) {{
        for (int n = 0; n < length; ++n) {{
            const int number = stack.data[list_at + n];
            const float* from = rows.data + {ROW} * (size_t)(first + number / {SIXTEEN}) + number % {SIXTEEN};
            float* at = to + {ROW} * (n / {SIXTEEN}) + n % {SIXTEEN};
            for (int k = 0; k < {ROW}; k += {SIXTEEN}) at[k] = from[k];
        }}
        // No row is kept in part, see `pack_edges`.
        for (int n = length; n % {SIXTEEN}; ++n) {{
            float* at = to + {ROW} * (n / {SIXTEEN}) + n % {SIXTEEN};
            for (int k = 0; k < {ROW}; k += {SIXTEEN}) at[k] = 1000.0f;
        }}
        to += {ROW} * ((length + {SIXTEEN - 1}) / {SIXTEEN});
    }};
    copy(near_at, near);
    copy(across_at, across);
#endif
"""
)
def keep_edges(
    rows: wp.array(dtype=wp.float32),
    first: int,
    stack: wp.array(dtype=wp.int32),
    near_at: int,
    near: int,
    across_at: int,
    across: int,
    kept: wp.array(dtype=wp.float32),
    kept_at: int,
):
    """Copy listed edges to rows of their own: those that are near, then those whose strips lie across."""
    ...


@wp.func_native(
    snippet=f"""
    {WIDEST_NUMBERS}
    wp::vec_t<23, float> found;
#if !defined(__CUDA_ARCH__)
    M numbers;
    for (int k = 0; k < WIDE; ++k) numbers[k] = k;
    {SUMS_OF_LOOK}
    const float room_y = half.c[1] * 1.0001f, room_z = half.c[2] * 1.0001f;
    const int among = first + (near_count + {SIXTEEN - 1}) / {SIXTEEN};
    {{
        const int count = near_count;
        const M met = {{}};
        for (int i = 0; WIDE * i < count; ++i) {{
            {EDGES}
            {FAR}
                {ADD}
            }}
            {LISTS}
        }}
    }}
    {{
        const int count = across_count, begin = {SIXTEEN} * (among - first), first = among;
        for (int i = 0; WIDE * i < count; ++i) {{
            {EDGES}
            {MET}
            for (unsigned left = bits_of(met); left; left &= left - 1, ++across)
                if (across < room_across) stack.data[across_at + across] = begin + WIDE * i + __builtin_ctz(left);
        }}
    }}
    const float share = 0.0f, off = 0.0f;
    {LOOK_ALONE}
#endif
    return found;
"""
)
def look_at_kept(
    rows: wp.array(dtype=wp.float32),
    first: int,
    near_count: int,
    across_count: int,
    c: wp.vec3,
    radius: float,
    half: wp.vec3,
    tolerance: float,
    stack: wp.array(dtype=wp.int32),
    near_at: int,
    room: int,
    across_at: int,
    room_across: int,
) -> Look:
    """`look_at_eights` by what `keep_edges` has kept, without the share of its centre."""
    ...
