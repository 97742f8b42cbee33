"""Boundary term in float32, with a bound of its error: what most voxels in doubt need instead of float64's sum.

The sum is that of `boundary_term`, over all edges with the strips swept along -x: with a and b the ways to an edge's
ends, alpha and beta their parts across x, and s = |a| - a.x, half a strip's solid angle is the argument of

    s_a s_b + alpha.beta - i alpha x (b - a),

where s is also |alpha|^2 / (|a| + a.x), without cancellation for a.x > 0. The product with the edge b - a, instead of
b, leaves an error in proportion to the edge's length: so many short edges far away add up to little.

Errors, in units of u = 2^-24: a and b are differences rounded once; |a| is right within 4 and s within 13 of itself,
s_a s_b within 27, alpha.beta within 5 |alpha||beta|, the product across within 4 of its two terms. With
S = s_a s_b + |alpha.beta| + |alpha x beta|, which is no less than s_a s_b + |alpha||beta|, the real part is right
within 28 S. The places on the lattice, which are those that count, are 0.09 away: |a| + |b| times 0.27 for the real
part, and 0.09 for the other. Divided by the larger of both parts, one factor turns the product by less than
1.1 + 8 |im| for its rounding. Where the real part is negative, the side of the edge has to be certain, as the argument
jumps by a turn there.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.fast_math import FUSED
from sdm.kernels.winding.boundary_term import Boundary, edges_of

wp.set_module_options({"enable_backward": False})

UNIT = 2.0**-24
# Room for S, for the terms of the product across, and for both parts by places on the lattice; of the quotients'
# second order; and of a product's and the last sum's rounding.
PARTS, ACROSS, SNAP_ALONG, SNAP_ACROSS = 32.0 * UNIT, 5.0 * UNIT, 0.4 * UNIT, 0.2 * UNIT
SECOND, TURNED, TURNED_MORE, SUMMED = 1.3, 1.1 * UNIT, 8.0 * UNIT, 16.0 * UNIT
# Beyond this a reciprocal may be taken for zero, and a product is halved so many times.
LARGEST, LARGEST_PRODUCT, SHRINK = 1.0e37, 1.0e9, 2.0**-30


# Turns (re, im) by the strip of an edge with its ends a and b off, where `ey` and `ez` are of b - a.
_TURN = f"""
    {FUSED}
#if defined(__CUDA_ARCH__)
#define RIM_ROOT(x) [](float y) {{ float r; asm("sqrt.approx.f32 %0, %1;" : "=f"(r) : "f"(y)); return r; }}(x)
#define RIM_QUOTIENT(x, y) __fdividef(x, y)
#else
#define RIM_ROOT(x) sqrtf(x)
#define RIM_QUOTIENT(x, y) ((x) / (y))
#endif
    float re = 1.0f, im = 0.0f, turns = 0.0f, error = 0.0f;
    int steps = 0;
    auto turn = [&](float ax, float ay, float az, float bx, float by, float bz, float ey, float ez) {{
        const float aside_a = FUSED(ay, ay, az * az), aside_b = FUSED(by, by, bz * bz);
        const float la = RIM_ROOT(FUSED(ax, ax, aside_a)), lb = RIM_ROOT(FUSED(bx, bx, aside_b));
        const float far_a = la + fabsf(ax), far_b = lb + fabsf(bx);
        const float sa = ax > 0.0f ? RIM_QUOTIENT(aside_a, far_a) : far_a;
        const float sb = bx > 0.0f ? RIM_QUOTIENT(aside_b, far_b) : far_b;
        const float along = FUSED(ay, by, az * bz);
        const float x = FUSED(sa, sb, along), y = FUSED(az, ey, -(ay * ez));
        const float sx = fabsf(x), sy = fabsf(y), most = sx < sy ? sy : sx, both = la + lb;
        const float dx = {PARTS}f * FUSED(sa, sb, fabsf(along) + sy) + {SNAP_ALONG}f * both;
        const float dy = {ACROSS}f * (fabsf(az * ey) + fabsf(ay * ez)) + {SNAP_ACROSS}f * both;
        const bool known = most > 10.0f * (dx + dy) && most < {LARGEST}f && (x > 0.0f || sy > dy);
        const float inverse = RIM_QUOTIENT(1.0f, most), part = sy * inverse;
        error += known ? {SECOND}f * inverse * FUSED(part, dx, dy) + FUSED({TURNED_MORE}f, part, {TURNED}f) : INFINITY;
        const float u = known && x < sy ? x * inverse : 1.0f, v = known ? y * inverse : 0.0f;
        const float new_re = FUSED(re, u, -(im * v)), new_im = FUSED(re, v, im * u);
        turns += im >= 0.0f && v > 0.0f && new_im < 0.0f ? 1.0f : 0.0f;
        turns -= im < 0.0f && v < 0.0f && new_im >= 0.0f ? 1.0f : 0.0f;
        re = new_re;
        im = new_im;
        // A factor is between 1 and 1.5: this is long before an overflow.
        steps += 1;
        if (steps % 32 == 0 && fabsf(re) + fabsf(im) > {LARGEST_PRODUCT}f) {{
            re *= {SHRINK}f;
            im *= {SHRINK}f;
        }}
    }};
"""
_SHARE = f"""
    const float angle = atan2f(im, re) + {2.0 * wp.PI}f * turns;
    return wp::vec2(angle / {2.0 * wp.PI}f, (error + {SUMMED}f * (1.0f + fabsf(angle))) / {2.0 * wp.PI}f);
"""


@wp.func_native(
    snippet=f"""
    {_TURN}
    for (int e = lane; e < count; e += lanes) {{
        const auto* at = ends.data + 2 * (first + e);
        const float ax = at[0].c[0] - p.c[0], ay = at[0].c[1] - p.c[1], az = at[0].c[2] - p.c[2];
        const float bx = at[1].c[0] - p.c[0], by = at[1].c[1] - p.c[1], bz = at[1].c[2] - p.c[2];
        turn(ax, ay, az, bx, by, bz, at[1].c[1] - at[0].c[1], at[1].c[2] - at[0].c[2]);
    }}
    {_SHARE}
"""
)
def rim_sum(ends: wp.array(dtype=wp.vec3), first: int, count: int, p: wp.vec3, lane: int, lanes: int) -> wp.vec2:
    """A lane's part of the share of so many edges of the winding number at p (scaled), and the largest error of it."""
    ...


@wp.func_native(
    snippet=f"""
    {_TURN}
    for (int i = lane; i < count; i += lanes) {{
        const auto* at = ends.data + 2 * stack.data[start + i];
        const float ax = at[0].c[0] - p.c[0], ay = at[0].c[1] - p.c[1], az = at[0].c[2] - p.c[2];
        const float bx = at[1].c[0] - p.c[0], by = at[1].c[1] - p.c[1], bz = at[1].c[2] - p.c[2];
        turn(ax, ay, az, bx, by, bz, at[1].c[1] - at[0].c[1], at[1].c[2] - at[0].c[2]);
    }}
    {_SHARE}
"""
)
def listed_sum(
    ends: wp.array(dtype=wp.vec3),
    stack: wp.array(dtype=wp.int32),
    start: int,
    count: int,
    p: wp.vec3,
    lane: int,
    lanes: int,
) -> wp.vec2:
    """`rim_sum` of the edges listed from a place on."""
    ...


@wp.func
def rim_part(boundary: Boundary, mesh: int, p: wp.vec3, lane: int, lanes: int):
    """A lane's part of the boundary's share of a mesh's winding number at p (scaled), and the largest error of it.

    The error is infinite if nothing is known.
    """
    return rim_sum(boundary.ends, mesh * boundary.count, edges_of(boundary), p, lane, lanes)
