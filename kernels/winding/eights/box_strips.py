"""Strips of listed edges at all voxels of a box on a CPU: what `rims.radial_strips.strips_at` finds for eight of them.

Each edge is made ready once for the whole box, with the others of a register.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.wide_numbers import ANGLE_OF, OFF_ANGLE, SIXTEEN, WIDEST_NUMBERS
from sdm.kernels.winding.eights.packed_edges import BEGIN, END, ROW, TIMES
from sdm.kernels.winding.rims.float32_sum import LARGEST_PRODUCT, SECOND, SHRINK, SUMMED, UNIT
from sdm.kernels.winding.rims.radial_strips import ANGLE, FIRST, SECOND_FACTOR, SNAP

wp.set_module_options({"enable_backward": False})

# Numbers of sixteen voxels: their places, then the shares of their winding numbers and the errors of those. And the
# most voxels of a box.
X, Y, Z, SHARE, ERROR, VOXELS = (SIXTEEN * number for number in range(6))
MOST = 512
ROOM = VOXELS * MOST // SIXTEEN
# Edges that are made ready at a time.
READY = 64


@wp.func_native(
    snippet=f"""
    {WIDEST_NUMBERS}
#if !defined(__CUDA_ARCH__)
    {ANGLE_OF}
    float* const voxels = places.data + at;
    constexpr int MOST = {MOST} / WIDE;
    const int groups = count / WIDE;
    auto left_out = [&](int g) {{ return !(which >> (WIDE * g / {SIXTEEN}) & 1); }};
    T re[MOST], im[MOST], error[MOST], crossed[MOST];
    M turns[MOST];
    // Where the numbers of a group of voxels are.
    auto group = [&](int g) {{ return voxels + {VOXELS} * (WIDE * g / {SIXTEEN}) + WIDE * g % {SIXTEEN}; }};
    auto load = [&](const float* from) {{ T x; __builtin_memcpy(&x, from, sizeof(T)); return x; }};
    for (int g = 0; g < groups; ++g) {{
        re[g] = one;
        im[g] = error[g] = crossed[g] = none;
        turns[g] = M{{}};
    }}
    // Numbers of some edges: their ends, the ways to those, lengths, k, n, m and errors.
    enum {{
        GX, GY, GZ, HX, HY, HZ, AX, AY, AZ, LA, LB, K, NX, NY, NZ, MX, MY, MZ, OFF_Q, OFF_1, OFF_2, OFF_S, OFF_K, OFTEN,
        COUNT
    }};
    T ready[COUNT][{READY} / WIDE];
    for (int begin = 0; begin < near; begin += {READY}) {{
        const int some = near - begin < {READY} ? near - begin : {READY};
        for (int i = 0; WIDE * i < some; ++i) {{
            T gx = one, gy = one, gz = one, hx = one, hy = one, hz = one, times = one;
            for (int k = 0; k < WIDE && WIDE * i + k < some; ++k) {{
                const int number = stack.data[near_at + begin + WIDE * i + k];
                const float* row = rows.data + {ROW} * (size_t)(first + number / {SIXTEEN}) + number % {SIXTEEN};
                gx[k] = row[{BEGIN}]; gy[k] = row[{BEGIN + SIXTEEN}]; gz[k] = row[{BEGIN + 2 * SIXTEEN}];
                hx[k] = row[{END}]; hy[k] = row[{END + SIXTEEN}]; hz[k] = row[{END + 2 * SIXTEEN}];
                times[k] = row[{TIMES}];
            }}
            const T ax = gx - c.c[0], ay = gy - c.c[1], az = gz - c.c[2];
            const T bx = hx - c.c[0], by = hy - c.c[1], bz = hz - c.c[2];
            const T la = root(ax * ax + ay * ay + az * az), lb = root(bx * bx + by * by + bz * bz), size = la * lb;
            const T off_q = radius * ({ANGLE}f * size + {SNAP}f * (la + lb));
            const T numbers[COUNT] = {{
                gx, gy, gz, hx, hy, hz, ax, ay, az, la, lb, size + ax * bx + ay * by + az * bz,
                ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx,
                lb * ax + la * bx, lb * ay + la * by, lb * az + la * bz,
                off_q, {FIRST}f * la + {SNAP}f, {SECOND_FACTOR}f * size + {SNAP}f * (la + lb), {SNAP}f * la,
                {SNAP}f * size + off_q, times,
            }};
            for (int number = 0; number < COUNT; ++number) ready[number][i] = numbers[number];
        }}
        const float* const edges = reinterpret_cast<const float*>(ready);
        for (int g = 0; g < groups; ++g) {{
            if (left_out(g)) continue;
            const float* const at_g = group(g);
            const T px = load(at_g + {X}), py = load(at_g + {Y}), pz = load(at_g + {Z});
            const T x = px - c.c[0], y = py - c.c[1], z = pz - c.c[2];
            T re_now = re[g], im_now = im[g], error_now = error[g];
            M turns_now = turns[g];
            for (int i = 0; i < some; ++i) {{
                auto of = [&](int number) {{ return edges[{READY} * number + i]; }};
                const T sx = of(GX) - px, sy = of(GY) - py, sz = of(GZ) - pz;
                const T tx = of(HX) - px, ty = of(HY) - py, tz = of(HZ) - pz;
                const T ls = root(sx * sx + sy * sy + sz * sz), lt = root(tx * tx + ty * ty + tz * tz);
                const T q = x * of(NX) + y * of(NY) + z * of(NZ), ends2 = ls * lt;
                const T f1 = of(LA) * (ends2 + (sx * tx + sy * ty + sz * tz))
                    + (of(AX) * sx + of(AY) * sy + of(AZ) * sz) * lt + (of(AX) * tx + of(AY) * ty + of(AZ) * tz) * ls;
                const T reach = of(LB) + lt, f2 = reach * of(K) - (x * of(MX) + y * of(MY) + z * of(MZ));
                const T e1 = of(OFF_1) * ends2 + of(OFF_S) * (ls + lt) + of(OFF_Q), e2 = of(OFF_2) * reach + of(OFF_K);
                const T sq = size_of(q), m1 = most_of(size_of(f1), sq), m2 = most_of(size_of(f2), sq);
                const T product = m1 * m2, inverse = about(product);
                const T u = (f1 * f2 - q * q) * inverse, w = q * (f1 + f2) * inverse;
                // If it is less than a tenth, e1 and e2 are less than a tenth of m1 and m2.
                const T part = (e1 * m2 + e2 * m1) * inverse, off = {SECOND}f * part + {8.0 * UNIT}f;
                const M known = (part < all(0.1f)) & (product > all(1.0e-30f))
                    & ((u > none) | (size_of(w) > 2.0f * off));
                error_now = error_now + where(known, of(OFTEN) * off, unknown);
                auto turn = [&] {{
                    const T new_re = re_now * u - im_now * w, new_im = re_now * w + im_now * u;
                    // By the signs of three numbers: over the negative half line one way, or the other.
                    const M below = (M)im_now, below_now = (M)new_im, back = (M)w;
                    turns_now += (M)((U)(~below & ~back & below_now) >> 31);
                    turns_now -= (M)((U)(below & back & ~below_now) >> 31);
                    re_now = new_re;
                    im_now = new_im;
                }};
                turn();
                if (of(OFTEN) > 1.0f) turn();
                if (i % 16 == 15) {{
                    const M large = size_of(re_now) + size_of(im_now) > all({LARGEST_PRODUCT}f);
                    const T shrink = where(large, all({SHRINK}f), one);
                    re_now = re_now * shrink;
                    im_now = im_now * shrink;
                }}
            }}
            re[g] = re_now;
            im[g] = im_now;
            error[g] = error_now;
            turns[g] = turns_now;
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
            if (left_out(g)) continue;
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
        if (left_out(g)) continue;
        T angle = none;
        if (near) angle = angle_of(re[g], im[g]);
        angle = where(error[g] < unknown, 2.0f * angle + {4.0 * wp.PI}f * __builtin_convertvector(turns[g], T), none);
        const T share = angle * {1.0 / (4.0 * wp.PI)}f + crossed[g];
        const T off = 2.0f * error[g] + {SUMMED}f * (1.0f + size_of(angle)) + {2.0 * OFF_ANGLE}f;
        const T wrong = off * {1.0 / (4.0 * wp.PI)}f;
        __builtin_memcpy(group(g) + {SHARE}, &share, sizeof(T));
        __builtin_memcpy(group(g) + {ERROR}, &wrong, sizeof(T));
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
    which: int,
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
        which: A bit for each sixteen of them; others are left out.
    """
    ...
