"""Strips of listed edges at all voxels of a box on a CPU: what `rims.radial_strips.strips_at` finds for eight of them.

Each edge is made ready once for the whole box, with the others of a register.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.wide_numbers import SIXTEEN, WIDEST_NUMBERS
from sdm.kernels.winding.eights.packed_edges import BEGIN, END, ROW, TIMES
from sdm.kernels.winding.rims.float32_sum import LARGEST_PRODUCT, SECOND, SHRINK, SUMMED, UNIT
from sdm.kernels.winding.rims.radial_strips import ANGLE, FIRST, SECOND_FACTOR, SNAP

wp.set_module_options({"enable_backward": False})

# Numbers of sixteen voxels: their places, then the shares of their winding numbers and the errors of those. And the
# most voxels of a box.
X, Y, Z, SHARE, ERROR, VOXELS = (SIXTEEN * number for number in range(6))
MOST = 512
ROOM = VOXELS * MOST // SIXTEEN


@wp.func_native(
    snippet=f"""
    {WIDEST_NUMBERS}
#if !defined(__CUDA_ARCH__)
    float* const voxels = places.data + at;
    constexpr int MOST = {MOST} / WIDE;
    const int groups = count / WIDE;
    T re[MOST], im[MOST], turns[MOST], error[MOST], crossed[MOST];
    // Where the numbers of a group of voxels are.
    auto group = [&](int g) {{ return voxels + {VOXELS} * (WIDE * g / {SIXTEEN}) + WIDE * g % {SIXTEEN}; }};
    auto load = [&](const float* from) {{ T x; __builtin_memcpy(&x, from, sizeof(T)); return x; }};
    for (int g = 0; g < groups; ++g) {{
        re[g] = one;
        im[g] = turns[g] = error[g] = crossed[g] = none;
    }}
    // Numbers of an edge: the ways to its ends, lengths, k, n, m and errors.
    enum {{ AX, AY, AZ, BX, BY, BZ, LA, LB, K, NX, NY, NZ, MX, MY, MZ, OFF_Q, OFF_2, TWICE, COUNT }};
    T ready[COUNT];
    for (int i = 0; i < near; ++i) {{
        if (i % WIDE == 0) {{
            T gx = one, gy = one, gz = one, hx = one, hy = one, hz = one, times = one;
            for (int k = 0; k < WIDE && i + k < near; ++k) {{
                const int number = stack.data[near_at + i + k];
                const float* row = rows.data + {ROW} * (size_t)(first + number / {SIXTEEN}) + number % {SIXTEEN};
                gx[k] = row[{BEGIN}]; gy[k] = row[{BEGIN + SIXTEEN}]; gz[k] = row[{BEGIN + 2 * SIXTEEN}];
                hx[k] = row[{END}]; hy[k] = row[{END + SIXTEEN}]; hz[k] = row[{END + 2 * SIXTEEN}];
                times[k] = row[{TIMES}];
            }}
            ready[TWICE] = times;
            const T ax = gx - c.c[0], ay = gy - c.c[1], az = gz - c.c[2];
            const T bx = hx - c.c[0], by = hy - c.c[1], bz = hz - c.c[2];
            const T la = root(ax * ax + ay * ay + az * az), lb = root(bx * bx + by * by + bz * bz), size = la * lb;
            ready[AX] = gx; ready[AY] = gy; ready[AZ] = gz;
            ready[BX] = hx; ready[BY] = hy; ready[BZ] = hz;
            ready[LA] = la; ready[LB] = lb;
            ready[K] = size + ax * bx + ay * by + az * bz;
            ready[NX] = ay * bz - az * by; ready[NY] = az * bx - ax * bz; ready[NZ] = ax * by - ay * bx;
            ready[MX] = lb * ax + la * bx; ready[MY] = lb * ay + la * by; ready[MZ] = lb * az + la * bz;
            ready[OFF_Q] = radius * ({ANGLE}f * size + {SNAP}f * (la + lb));
            ready[OFF_2] = {SECOND_FACTOR}f * size + {SNAP}f * (la + lb);
        }}
        const int e = i % WIDE;
        const float gx = ready[AX][e], gy = ready[AY][e], gz = ready[AZ][e];
        const float hx = ready[BX][e], hy = ready[BY][e], hz = ready[BZ][e];
        const float ax = gx - c.c[0], ay = gy - c.c[1], az = gz - c.c[2];
        const float la = ready[LA][e], lb = ready[LB][e], k = ready[K][e];
        const float nx = ready[NX][e], ny = ready[NY][e], nz = ready[NZ][e];
        const float mx = ready[MX][e], my = ready[MY][e], mz = ready[MZ][e];
        const float off_q = ready[OFF_Q][e], off_2 = ready[OFF_2][e];
        const bool twice = ready[TWICE][e] > 1.0f;
        const float off_1 = {FIRST}f * la + {SNAP}f, off_s = {SNAP}f * la, off_k = {SNAP}f * la * lb + off_q;
        for (int g = 0; g < groups; ++g) {{
            const float* const at_g = group(g);
            const T px = load(at_g + {X}), py = load(at_g + {Y}), pz = load(at_g + {Z});
            const T x = px - c.c[0], y = py - c.c[1], z = pz - c.c[2];
            const T sx = gx - px, sy = gy - py, sz = gz - pz, tx = hx - px, ty = hy - py, tz = hz - pz;
            const T ls = root(sx * sx + sy * sy + sz * sz), lt = root(tx * tx + ty * ty + tz * tz);
            const T q = x * nx + y * ny + z * nz, ends2 = ls * lt;
            const T f1 = la * (ends2 + (sx * tx + sy * ty + sz * tz)) + (ax * sx + ay * sy + az * sz) * lt
                + (ax * tx + ay * ty + az * tz) * ls;
            const T reach = lb + lt, f2 = reach * k - (x * mx + y * my + z * mz);
            const T e1 = off_1 * ends2 + off_s * (ls + lt) + off_q, e2 = off_2 * reach + off_k;
            const T sq = size_of(q), m1 = most_of(size_of(f1), sq), m2 = most_of(size_of(f2), sq);
            const T product = m1 * m2, inverse = one / product;
            const T u = (f1 * f2 - q * q) * inverse, w = q * (f1 + f2) * inverse;
            const T off = {SECOND}f * (e1 * m2 + e2 * m1) * inverse + {8.0 * UNIT}f;
            const M known = (m1 > 10.0f * e1) & (m2 > 10.0f * e2) & (product > all(1.0e-30f))
                & ((u > none) | (size_of(w) > 2.0f * off));
            error[g] = error[g] + where(known, twice ? off + off : off, unknown);
            const T kept = where(known, u, one), turned = where(known, w, none);
            T x_now = re[g], y_now = im[g], turns_now = turns[g];
            for (int time = 0; time < 1 + twice; ++time) {{
                const T new_re = x_now * kept - y_now * turned, new_im = x_now * turned + y_now * kept;
                const M below = y_now < none, below_now = new_im < none;
                turns_now = turns_now + where(~below & (turned > none) & below_now, one, none);
                turns_now = turns_now - where(below & (turned < none) & ~below_now, one, none);
                x_now = new_re;
                y_now = new_im;
            }}
            turns[g] = turns_now;
            if (i % 16 == 15) {{
                const M large = size_of(x_now) + size_of(y_now) > all({LARGEST_PRODUCT}f);
                const T shrink = where(large, all({SHRINK}f), one);
                x_now = x_now * shrink;
                y_now = y_now * shrink;
            }}
            re[g] = x_now;
            im[g] = y_now;
        }}
    }}
    for (int i = 0; i < across; ++i) {{
        const int number = stack.data[across_at + i];
        const float* row = rows.data + {ROW} * (size_t)(first + number / {SIXTEEN}) + number % {SIXTEEN};
        const float ax = row[{BEGIN}] - c.c[0], ay = row[{BEGIN + SIXTEEN}] - c.c[1];
        const float az = row[{BEGIN + 2 * SIXTEEN}] - c.c[2], bx = row[{END}] - c.c[0];
        const float by = row[{END + SIXTEEN}] - c.c[1], bz = row[{END + 2 * SIXTEEN}] - c.c[2];
        const float la = sqrtf(ax * ax + ay * ay + az * az), lb = sqrtf(bx * bx + by * by + bz * bz);
        const float nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
        const float sign = nx < 0.0f ? -1.0f : 1.0f, n = sign * nx;
        const float off_n = {ANGLE}f * la * lb + {SNAP}f * (la + lb), off_q = radius * off_n;
        const float off_a = radius * {UNIT}f * (6.0f * la + 1.0f), off_b = radius * {UNIT}f * (6.0f * lb + 1.0f);
        const float off_it = off_a + off_b + off_n;
        const float fay = sign * ay, faz = sign * az, fby = sign * by, fbz = sign * bz;
        const bool flat = n <= off_n;
        for (int g = 0; g < groups; ++g) {{
            const float* const at_g = group(g);
            const T x = load(at_g + {X}) - c.c[0], y = load(at_g + {Y}) - c.c[1], z = load(at_g + {Z}) - c.c[2];
            const T ua = z * fay - y * faz, ub = y * fbz - z * fby, over_it = ua + ub - n;
            const T uq = -sign * (x * nx + y * ny + z * nz);
            const T low = least(least(ua - off_a, ub - off_b), least(over_it - off_it, uq - off_q));
            const T high = least(least(ua + off_a, ub + off_b), least(over_it + off_it, uq + off_q));
            crossed[g] = crossed[g] + where(low > none, all(sign * row[{TIMES}]), none);
            error[g] = error[g] + where((high > none) & (low <= none), unknown, none);
            if (flat) {{
                // Where c may be in the strip's plane itself, it may be met from either side.
                const T other = least(least(off_a - ua, off_b - ub), least(off_it - over_it, off_q - uq));
                error[g] = error[g] + where(other > none, unknown, none);
            }}
        }}
    }}
    for (int g = 0; g < groups; ++g) {{
        for (int k = 0; k < WIDE; ++k) {{
            const float angle = near ? 2.0f * atan2f(im[g][k], re[g][k]) + {4.0 * wp.PI}f * turns[g][k] : 0.0f;
            group(g)[{SHARE} + k] = angle / {4.0 * wp.PI}f + crossed[g][k];
            const float off = 2.0f * error[g][k] + {SUMMED}f * (1.0f + fabsf(angle));
            group(g)[{ERROR} + k] = off / {4.0 * wp.PI}f;
        }}
    }}
#endif
"""
)
def strips_of_box(
    rows: wp.array(dtype=wp.float32),
    first: int,
    stack: wp.array(dtype=wp.int32),
    near_at: int,
    near: int,
    across_at: int,
    across: int,
    c: wp.vec3,
    radius: float,
    places: wp.array(dtype=wp.float32),
    at: int,
    count: int,
):
    """Write the shares of listed edges' strips of the winding numbers at the voxels of a box, up to MOST by sixteens,
    with what lies across the way from c to each; and their largest errors.

    Args:
        rows: Packed edges.
        first: The first row of the mesh.
        stack: With the lists of `look_at_eights`.
        near_at: Where edges are listed that are near.
        near: How many.
        across_at: Where those are whose strips along -x lie across the box.
        across: How many.
        c: The place that strips are swept away from.
        radius: Of the ball about it that holds the voxels.
        places: Numbers of sixteen voxels each, ROOM for each worker.
        at: Where this worker's begin.
        count: How many voxels, a multiple of sixteen.
    """
    ...
