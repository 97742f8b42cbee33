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

from sdm.kernels.primitives.wide_numbers import NUMBERS
from sdm.kernels.winding.boundary_term import Boundary, edges_of

wp.set_module_options({"enable_backward": False})

UNIT = 2.0**-24
# Room for S, for the terms of the product across, and for both parts by places on the lattice; of the quotients'
# second order; and of a product's and the last sum's rounding.
PARTS, ACROSS, SNAP_ALONG, SNAP_ACROSS = 32.0 * UNIT, 5.0 * UNIT, 0.4 * UNIT, 0.2 * UNIT
SECOND, TURNED, TURNED_MORE, SUMMED = 1.3, 1.1 * UNIT, 8.0 * UNIT, 16.0 * UNIT
# Beyond this a reciprocal may be taken for zero, and a product is halved so many times.
LARGEST, LARGEST_PRODUCT, SHRINK = 1.0e37, 1.0e9, 2.0**-30


# Turns (re, im) by the strips of edges with their ends a and b off, `ey` and `ez` being of b - a, if they are there.
TURN = f"""
    T re = one, im = none, turns = none, error = none;
    int turned = 0;
    auto turn = [&](T ax, T ay, T az, T bx, T by, T bz, T ey, T ez, M there) {{
        const T aside_a = ay * ay + az * az, aside_b = by * by + bz * bz;
        const T la = root(ax * ax + aside_a), lb = root(bx * bx + aside_b);
        const T far_a = la + size_of(ax), far_b = lb + size_of(bx);
        const T sa = where(ax > none, over(aside_a, far_a), far_a), sb = where(bx > none, over(aside_b, far_b), far_b);
        const T along = ay * by + az * bz, x = sa * sb + along, y = az * ey - ay * ez;
        const T sx = size_of(x), sy = size_of(y), most = most_of(sx, sy), both = la + lb;
        const T dx = {PARTS}f * (sa * sb + size_of(along) + sy) + {SNAP_ALONG}f * both;
        const T dy = {ACROSS}f * (size_of(az * ey) + size_of(ay * ez)) + {SNAP_ACROSS}f * both;
        const M known = (most > 10.0f * (dx + dy)) & (most < all({LARGEST}f)) & ((x > none) | (sy > dy));
        const T inverse = over(one, most), part = sy * inverse;
        const T off = {SECOND}f * inverse * (part * dx + dy) + ({TURNED_MORE}f * part + {TURNED}f);
        error = error + where(there, where(known, off, unknown), none);
        const T u = where(known & there & (x < sy), x * inverse, one), v = where(known & there, y * inverse, none);
        const T new_re = re * u - im * v, new_im = re * v + im * u;
        turns = turns + where((im >= none) & (v > none) & (new_im < none), one, none);
        turns = turns - where((im < none) & (v < none) & (new_im >= none), one, none);
        re = new_re;
        im = new_im;
        // A factor is between 1 and 1.5: this is long before an overflow.
        turned += 1;
        if (turned % 32 == 0) {{
            const T shrink = where(size_of(re) + size_of(im) > all({LARGEST_PRODUCT}f), all({SHRINK}f), one);
            re = re * shrink;
            im = im * shrink;
        }}
    }};
"""
SHARES = f"""
    float share = 0.0f, off = 0.0f;
    for (int k = 0; k < WIDE; ++k) {{
        const float angle = atan2f(get(im, k), get(re, k)) + {2.0 * wp.PI}f * get(turns, k);
        share += angle / {2.0 * wp.PI}f;
        off += (get(error, k) + {SUMMED}f * (1.0f + fabsf(angle))) / {2.0 * wp.PI}f;
    }}
"""


@wp.func_native(
    snippet=f"""
    {NUMBERS}
    {TURN}
    for (int e = WIDE * lane; e < count; e += WIDE * lanes) {{
        T ax = one, ay = one, az = one, bx = one, by = one, bz = one, ey = one, ez = one, weight = none;
        for (int k = 0; k < WIDE; ++k) {{
            if (e + k < count) {{
                const auto* at = ends.data + 2 * (size_t)(first + e + k);
                put(ax, k, at[0].c[0] - p.c[0]); put(ay, k, at[0].c[1] - p.c[1]); put(az, k, at[0].c[2] - p.c[2]);
                put(bx, k, at[1].c[0] - p.c[0]); put(by, k, at[1].c[1] - p.c[1]); put(bz, k, at[1].c[2] - p.c[2]);
                put(ey, k, at[1].c[1] - at[0].c[1]); put(ez, k, at[1].c[2] - at[0].c[2]);
                put(weight, k, 1.0f);
            }}
        }}
        turn(ax, ay, az, bx, by, bz, ey, ez, weight > none);
    }}
    {SHARES}
    return wp::vec2(share, off);
"""
)
def rim_sum(ends: wp.array(dtype=wp.vec3), first: int, count: int, p: wp.vec3, lane: int, lanes: int) -> wp.vec2:
    """A lane's part of the share of so many edges of the winding number at p (scaled), and the largest error of it."""
    ...


@wp.func
def rim_part(boundary: Boundary, mesh: int, p: wp.vec3, lane: int, lanes: int):
    """A lane's part of the boundary's share of a mesh's winding number at p (scaled), and the largest error of it.

    The error is infinite if nothing is known.
    """
    return rim_sum(boundary.ends, mesh * boundary.count, edges_of(boundary), p, lane, lanes)
