"""Strips of boundary edges swept away from a box's centre: what a winding number changes by within the box.

Sweep each boundary edge to infinity, radially away from a point c. As each edge begins where another ends, the sides of
these strips cancel, and surface and strips together are closed. So the winding number at x is that at c plus the
strips' share as it is seen from x (from c all are seen edge-on, and share nothing), but for surfaces in between. And
the boundary's share B of `boundary_term`, whose strips lead along -x, is

    B(x) = B(c) + sum of strips(x) / 4 pi + J(x),

where J counts the strips along -x that lie across the way from c to x.

With a and b the ways from c to an edge's ends, a' and b' those from x, q = x.(a x b) and k = |a||b| + a.b, half a
strip's solid angle is the argument of (F1 + iq)(F2 + iq), by triangles of which one or two corners are infinitely far:

    F1 = |a||a'||b'| + (a.a')|b'| + (a.b')|a'| + |a|(a'.b'),   F2 = (|b| + |b'|) k - x.(|b| a + |a| b).

Where the edge is far for the size of the box, that is the polynomial of `cap_taylor.add_edge`, which says why.

The way from c to x meets a strip along -x if a and b are on different sides of it, seen along x, if x is beyond the
edge there, and if the edge is further along +x than the way: with s(v) = x_y v_z - x_z v_y, n = (a x b)_x and sigma the
sign of n, if sigma s(b), -sigma s(a), sigma (s(b) - s(a) - n) and -sigma q are positive. It then counts sigma.

Errors, in units of u = 2^-24: lengths are right within 4 of themselves, ways within 1, so that F1 is right within
60 |a||a'||b'|, F2 within 30 |a||b|(|b| + |b'|), and q within 10 |x||a||b|. The places on the lattice, which are those
that count, are 0.1 away, for which there are the products of two lengths. What is closer to a jump than that is not
known.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.wide_numbers import NUMBERS
from sdm.kernels.winding.rims.float32_sum import LARGEST_PRODUCT, SECOND, SHARES, SHRINK, SUMMED, TURN, UNIT

wp.set_module_options({"enable_backward": False})

# The nearest far edge, in radii of the box, and the largest |a||b|/k: see `cap_taylor`.
NEAREST_EDGE, LARGEST_RATIO = 2.0, 1.0e4
# Errors of F1, F2 and q, and what places on the lattice add.
FIRST, SECOND_FACTOR, ANGLE, SNAP = 60.0 * UNIT, 30.0 * UNIT, 10.0 * UNIT, 1.0 * UNIT
# Voxels that a lane of a GPU, or of a CPU, looks at together.
VOXELS = {"cuda": 4, "cpu": 8}

Look = wp.types.vector(length=23, dtype=wp.float32)
Eight = wp.types.vector(length=8, dtype=wp.float32)
Sixteen = wp.types.vector(length=16, dtype=wp.float32)
# Places in a look: the polynomial, its error and drift; the share at the centre, and its error; how many edges are
# near, how many strips lie across the box, and how many polynomials were added.
SLOPE, SQUARES, PRODUCTS, CUBES, ERROR, DRIFT, SHARE, SHARE_ERROR, NEAR, ACROSS_BOX, STEPS = (
    0, 3, 6, 9, 16, 17, 18, 19, 20, 21, 22,
)  # fmt: skip

# Parts of a look that `eights.packed_edges` has too: its sums before the first edge; the derivatives in the terms of
# the polynomial; the edges whose strips along -x may lie across the box; the sums in their places.
SUMS_OF_LOOK = """T slope[3], squares[3], products[3], cubes[7];
    for (int k = 0; k < 3; ++k) slope[k] = squares[k] = products[k] = none;
    for (int k = 0; k < 7; ++k) cubes[k] = none;
    T bounds = none, drift = none, steps = none;
    int near = 0, across = 0;
    const float cube = radius * radius * radius / 3.0f, square = radius * radius;"""
DERIVATIVES = """const T p = ia * (3.0f * ia2 * ik + (3.0f * ia + ib) * once) + common;
            const T q = (ia2 + ib2) * once + common;
            const T r = ib * (3.0f * ib2 * ik + (3.0f * ib + ia) * once) + common;
            const T level = -(ia * ia2 + ib * ib2) * ik - w * w * once;
            const T ux = ia * ax, uy = ia * ay, uz = ia * az, vx = ib * bx, vy = ib * by, vz = ib * bz;
            const T gx = p * ux + q * vx, gy = p * uy + q * vy, gz = p * uz + q * vz;
            const T hx = q * ux + r * vx, hy = q * uy + r * vy, hz = q * uz + r * vz;
            const T xx = gx * ux + hx * vx + level, yy = gy * uy + hy * vy + level, zz = gz * uz + hz * vz + level;
            const T xy = 2.0f * (gx * uy + hx * vy), xz = 2.0f * (gx * uz + hx * vz), yz2 = 2.0f * (gy * uz + hy * vz);
""".rstrip()
MET_ACROSS = """const M met = there & (size_of(nx) <= room_y * size_of(ez) + room_z * size_of(ey) + snap)
            & (least(ay, by) <= room_y + snap) & (most_of(ay, by) >= -room_y - snap)
            & (least(az, bz) <= room_z + snap) & (most_of(az, bz) >= -room_z - snap)
            & (most_of(ax, bx) >= -half.c[0] * 1.0001f - snap);"""
LOOK_OF_SUMS = f"""auto sum = [&](T x) {{ float s = 0.0f; for (int k = 0; k < WIDE; ++k) s += get(x, k); return s; }};
    for (int k = 0; k < 3; ++k) {{
        found.c[{SLOPE} + k] = sum(slope[k]);
        found.c[{SQUARES} + k] = sum(squares[k]);
        found.c[{PRODUCTS} + k] = sum(products[k]);
    }}
    for (int k = 0; k < 7; ++k) found.c[{CUBES} + k] = sum(cubes[k]);
    found.c[{ERROR}] = sum(bounds);
    found.c[{DRIFT}] = sum(drift);
    found.c[{STEPS}] = sum(steps);
    {SHARES}
    found.c[{SHARE}] = share;
    found.c[{SHARE_ERROR}] = off;
    found.c[{NEAR}] = (float)near;
    found.c[{ACROSS_BOX}] = (float)across;"""


@wp.func_native(
    snippet=f"""
    {NUMBERS}
    {TURN}
    wp::vec_t<23, float> found;
    {SUMS_OF_LOOK}
    for (int first_of_turn = 0; first_of_turn < count; first_of_turn += WIDE * lanes) {{
        T ax = one, ay = one, az = one, bx = one, by = one, bz = one, ex = none, ey = none, ez = none, is_there = none;
        const int e = first_of_turn + WIDE * lane;
        for (int k = 0; k < WIDE; ++k) {{
            if (e + k < count) {{
                const auto* at = ends.data + 2 * (size_t)(first + e + k);
                put(ax, k, at[0].c[0] - c.c[0]); put(ay, k, at[0].c[1] - c.c[1]); put(az, k, at[0].c[2] - c.c[2]);
                put(bx, k, at[1].c[0] - c.c[0]); put(by, k, at[1].c[1] - c.c[1]); put(bz, k, at[1].c[2] - c.c[2]);
                put(ex, k, at[1].c[0] - at[0].c[0]); put(ey, k, at[1].c[1] - at[0].c[1]);
                put(ez, k, at[1].c[2] - at[0].c[2]);
                put(is_there, k, 1.0f);
            }}
        }}
        const M there = is_there > none;
        const T aside_a = ay * ay + az * az, aside_b = by * by + bz * bz, yz = ay * by + az * bz;
        const T la2 = ax * ax + aside_a, lb2 = bx * bx + aside_b, la = root(la2), lb = root(lb2), both = la + lb;
        const T nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
        // The share at the centre.
        turn(ax, ay, az, bx, by, bz, ey, ez, there);
        // The polynomial, as `cap_taylor.add_edge` has it.
        const T length2 = ex * ex + ey * ey + ez * ez;
        const T along = -(ax * ex + ay * ey + az * ez);
        T part = where(length2 > none, over(along, most_of(length2, all(1.0e-37f))), none);
        part = least(most_of(part, none), one);
        const T wx = ax + part * ex, wy = ay + part * ey, wz = az + part * ez;
        const T d = 0.999f * root(wx * wx + wy * wy + wz * wz) - 1.0e-6f * both;
        const T dot = ax * bx + yz, size = la * lb, k = size + dot;
        const T rho = over(all(radius), d), reach = least(over(root(length2), d), all(1.5707964f));
        const T bound = over(reach * (rho * rho) * (rho * rho), 1.0f - rho);
        const M far = there & (d > all({NEAREST_EDGE}f * radius)) & (k * {LARGEST_RATIO}f > size)
            & (bound <= all(tolerance));
        if (any(far)) {{
            const T ia = over(one, la), ib = over(one, lb), ik = over(one, k), w = ia + ib, s1 = w * ik;
            const T once = both * ik * ik, pull = w * once, ia2 = ia * ia, ib2 = ib * ib;
            const T fa = ia * (ia2 * ik + pull), fb = ib * (ib2 * ik + pull);
            const T sx = ax * fa + bx * fb, sy = ay * fa + by * fb, sz = az * fa + bz * fb;
            const T common = w * ik * ik * (2.0f * both * both * ik - 1.0f);
            {DERIVATIVES}
            const T flat = root(nx * nx + ny * ny + nz * nz);
            const T linear = s1 * radius, squared = root(sx * sx + sy * sy + sz * sz) * square;
            const T change = linear + squared + cube * (p + 2.0f * q + r - 3.0f * level);
            const T off = change * (20.0f * size + flat * (20.0f * size * ik + 40.0f)) + 2.0f * over(reach, d);
            const T sixth = where(far, all(1.0f / 6.0f), none);
            slope[0] = slope[0] + where(far, s1 * nx, none);
            slope[1] = slope[1] + where(far, s1 * ny, none);
            slope[2] = slope[2] + where(far, s1 * nz, none);
            squares[0] = squares[0] + where(far, 0.5f * nx * sx, none);
            squares[1] = squares[1] + where(far, 0.5f * ny * sy, none);
            squares[2] = squares[2] + where(far, 0.5f * nz * sz, none);
            products[0] = products[0] + where(far, 0.5f * (nx * sy + ny * sx), none);
            products[1] = products[1] + where(far, 0.5f * (nx * sz + nz * sx), none);
            products[2] = products[2] + where(far, 0.5f * (ny * sz + nz * sy), none);
            const T mx = nx * sixth, my = ny * sixth, mz = nz * sixth;
            cubes[0] = cubes[0] + where(far, mx * xx, none);
            cubes[1] = cubes[1] + where(far, my * xx + mx * xy, none);
            cubes[2] = cubes[2] + where(far, mz * xx + mx * xz, none);
            cubes[3] = cubes[3] + where(far, mx * yy + my * xy, none);
            cubes[4] = cubes[4] + where(far, mx * yz2 + my * xz + mz * xy, none);
            cubes[5] = cubes[5] + where(far, my * yy, none);
            cubes[6] = cubes[6] + where(far, mz * yy + my * yz2, none);
            drift = drift + where(far, change * flat, none);
            bounds = bounds + where(far, {1.0001}f * bound + {UNIT}f * off, none);
            steps = steps + where(far, one, none);
        }}
        const M near_here = there & ~far;
        // Strips along -x across the box: a line and a rectangle, seen along x.
        const float room_y = half.c[1] * 1.0001f, room_z = half.c[2] * 1.0001f;
        const T snap = 2.0e-6f * (1.0f + both);
        {MET_ACROSS}
#if defined(__CUDA_ARCH__)
        const unsigned before = (1u << lane) - 1u;
        const unsigned nears = __ballot_sync(0xffffffffu, near_here), mets = __ballot_sync(0xffffffffu, met);
        const int place = near + __popc(nears & before), other = across + __popc(mets & before);
        if (near_here && place < room) stack.data[near_at + place] = first + e;
        if (met && other < room_across) stack.data[across_at + other] = first + e;
        near += __popc(nears);
        across += __popc(mets);
#else
        for (int i = 0; i < 8; ++i) {{
            if (near_here[i]) {{ if (near < room) stack.data[near_at + near] = first + e + i; ++near; }}
            if (met[i]) {{ if (across < room_across) stack.data[across_at + across] = first + e + i; ++across; }}
        }}
#endif
    }}
    {LOOK_OF_SUMS}
    return found;
"""
)
def look_at_edges(
    ends: wp.array(dtype=wp.vec3),
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
    lane: int,
    lanes: int,
) -> Look:
    """A lane's part of the polynomial of far strips about c, and of the boundary's share there; and lists of the edges
    that are near, or whose strips along -x lie across a box of these half-widths, all of whose points are within
    `radius` of c.
    """
    ...


# Adds the strips of listed edges, seen from some voxels: solid angles, and twice their largest errors.
_STRIPS = f"""
    T re[TOGETHER], im[TOGETHER], turns[TOGETHER], error[TOGETHER], crossed[TOGETHER];
    for (int v = 0; v < TOGETHER; ++v) {{
        re[v] = one;
        im[v] = turns[v] = error[v] = crossed[v] = none;
    }}
    for (int i = 0; i < near; ++i) {{
        const auto* at = ends.data + 2 * (size_t)stack.data[near_at + i];
        const float gx = at[0].c[0], gy = at[0].c[1], gz = at[0].c[2];
        const float hx = at[1].c[0], hy = at[1].c[1], hz = at[1].c[2];
        const float ax = gx - c.c[0], ay = gy - c.c[1], az = gz - c.c[2];
        const float bx = hx - c.c[0], by = hy - c.c[1], bz = hz - c.c[2];
        const float la = sqrtf(ax * ax + ay * ay + az * az), lb = sqrtf(bx * bx + by * by + bz * bz);
        const float k = la * lb + ax * bx + ay * by + az * bz;
        const float nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
        const float mx = lb * ax + la * bx, my = lb * ay + la * by, mz = lb * az + la * bz;
        const float off_q = radius * ({ANGLE}f * la * lb + {SNAP}f * (la + lb));
        const float off_2 = {SECOND_FACTOR}f * la * lb + {SNAP}f * (la + lb);
        for (int v = 0; v < TOGETHER; ++v) {{
            const T x = px[v] - c.c[0], y = py[v] - c.c[1], z = pz[v] - c.c[2];
            const T sx = gx - px[v], sy = gy - py[v], sz = gz - pz[v];
            const T tx = hx - px[v], ty = hy - py[v], tz = hz - pz[v];
            const T ls = root(sx * sx + sy * sy + sz * sz), lt = root(tx * tx + ty * ty + tz * tz);
            const T q = x * nx + y * ny + z * nz, ends2 = ls * lt;
            const T f1 = la * ends2 + (ax * sx + ay * sy + az * sz) * lt + (ax * tx + ay * ty + az * tz) * ls
                + la * (sx * tx + sy * ty + sz * tz);
            const T reach = lb + lt, f2 = reach * k - (x * mx + y * my + z * mz);
            const T e1 = ({FIRST}f * la + {SNAP}f) * ends2 + ({SNAP}f * la) * (ls + lt) + off_q;
            const T e2 = off_2 * reach + ({SNAP}f * la * lb + off_q);
            const T sq = size_of(q), m1 = most_of(size_of(f1), sq), m2 = most_of(size_of(f2), sq);
            const T product = m1 * m2, inverse = over(one, product);
            const T u = (f1 * f2 - q * q) * inverse, w = q * (f1 + f2) * inverse;
            const T off = {SECOND}f * (e1 * m2 + e2 * m1) * inverse + {8.0 * UNIT}f;
            const M known = (m1 > 10.0f * e1) & (m2 > 10.0f * e2) & (product > all(1.0e-30f))
                & ((u > none) | (size_of(w) > 2.0f * off));
            error[v] = error[v] + where(known, off, unknown);
            const T kept = where(known, u, one), turned = where(known, w, none);
            const T new_re = re[v] * kept - im[v] * turned, new_im = re[v] * turned + im[v] * kept;
            turns[v] = turns[v] + where((im[v] >= none) & (turned > none) & (new_im < none), one, none);
            turns[v] = turns[v] - where((im[v] < none) & (turned < none) & (new_im >= none), one, none);
            re[v] = new_re;
            im[v] = new_im;
            if (i % 32 == 31) {{
                const T shrink = where(size_of(re[v]) + size_of(im[v]) > all({LARGEST_PRODUCT}f), all({SHRINK}f), one);
                re[v] = re[v] * shrink;
                im[v] = im[v] * shrink;
            }}
        }}
    }}
    for (int i = 0; i < across; ++i) {{
        const auto* at = ends.data + 2 * (size_t)stack.data[across_at + i];
        const float ax = at[0].c[0] - c.c[0], ay = at[0].c[1] - c.c[1], az = at[0].c[2] - c.c[2];
        const float bx = at[1].c[0] - c.c[0], by = at[1].c[1] - c.c[1], bz = at[1].c[2] - c.c[2];
        const float la = sqrtf(ax * ax + ay * ay + az * az), lb = sqrtf(bx * bx + by * by + bz * bz);
        const float nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
        const float sign = nx < 0.0f ? -1.0f : 1.0f, n = sign * nx;
        const float off_n = {ANGLE}f * la * lb + {SNAP}f * (la + lb), off_q = radius * off_n;
        const float off_a = radius * {UNIT}f * (6.0f * la + 1.0f), off_b = radius * {UNIT}f * (6.0f * lb + 1.0f);
        const float fay = sign * ay, faz = sign * az, fby = sign * by, fbz = sign * bz;
        for (int v = 0; v < TOGETHER; ++v) {{
            const T x = px[v] - c.c[0], y = py[v] - c.c[1], z = pz[v] - c.c[2];
            const T ua = z * fay - y * faz, ub = y * fbz - z * fby, over_it = ua + ub - n;
            const T uq = -sign * (x * nx + y * ny + z * nz);
            const T low = least(least(ua - off_a, ub - off_b), least(over_it - (off_a + off_b + off_n), uq - off_q));
            const T high = least(least(ua + off_a, ub + off_b), least(over_it + (off_a + off_b + off_n), uq + off_q));
            crossed[v] = crossed[v] + where(low > none, all(sign), none);
            // Where c may be in the strip's plane itself, it may be met from either side.
            const T other = least(least(off_a - ua, off_b - ub), least((off_a + off_b + off_n) - over_it, off_q - uq));
            const M unsure = (high > none) & (low <= none);
            error[v] = error[v] + where(unsure | ((other > none) & (all(n) <= all(off_n))), unknown, none);
        }}
    }}
    for (int v = 0; v < TOGETHER; ++v) {{
        for (int k = 0; k < WIDE; ++k) {{
            const float angle = 2.0f * atan2f(get(im[v], k), get(re[v], k)) + {4.0 * wp.PI}f * get(turns[v], k);
            found.c[WIDE * v + k] = angle / {4.0 * wp.PI}f + get(crossed[v], k);
            const float off = 2.0f * get(error[v], k) + {SUMMED}f * (1.0f + fabsf(angle));
            found.c[8 + WIDE * v + k] = off / {4.0 * wp.PI}f;
        }}
    }}
"""


@wp.func_native(
    snippet=f"""
    {NUMBERS}
#if defined(__CUDA_ARCH__)
    constexpr int TOGETHER = {VOXELS["cuda"]};
    const float* px = xs.c; const float* py = ys.c; const float* pz = zs.c;
#else
    constexpr int TOGETHER = 1;
    T px[1], py[1], pz[1];
    for (int k = 0; k < 8; ++k) {{ put(px[0], k, xs.c[k]); put(py[0], k, ys.c[k]); put(pz[0], k, zs.c[k]); }}
#endif
    wp::vec_t<16, float> found;
    {_STRIPS}
    return found;
"""
)
def strips_at(
    ends: wp.array(dtype=wp.vec3),
    stack: wp.array(dtype=wp.int32),
    near_at: int,
    near: int,
    across_at: int,
    across: int,
    c: wp.vec3,
    radius: float,
    xs: Eight,
    ys: Eight,
    zs: Eight,
) -> Sixteen:
    """Shares of listed edges' strips of the winding numbers at eight voxels (scaled; of the first four on a GPU), with
    what lies across the way from c; then their largest errors.
    """
    ...
