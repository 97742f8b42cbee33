"""Boundary edges by sixteens, each number of sixteen edges in a row: sums over all edges on a CPU, which takes as many
of them at once as it has registers for.

As `rims.float32_sum` and `rims.radial_strips` have them, but quotients are few, which take a CPU as long as ten
products:

- s_a s_b + alpha.beta is taken times the denominators of both s, which are positive: an argument stays what it is.
- Instead of the distance d of an edge, which has to be no less than what is said, there is the larger of that of its
  line, |a x b| / l, and of (|a| + |b| - l)/2, which is no more than d as |a| and |b| are at most d and a part of l.
- Of 1/|a|, 1/|b| and 1/k one quotient is taken, of all three together; for 1/(1 - rho) there is 1 + rho + 2 rho^2,
  which is no less up to a half.
- a x b is a x (b - a), and wrong by 6 |a| l.
- An edge that is met twice is one whose strip counts twice.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.wide_numbers import SIXTEEN, WIDEST_NUMBERS
from sdm.kernels.winding.boundary_term import Boundary, edges_of
from sdm.kernels.winding.near_caps import UNIT
from sdm.kernels.winding.rims.float32_sum import (
    ACROSS,
    LARGEST,
    LARGEST_PRODUCT,
    PARTS,
    SECOND,
    SHARES,
    SHRINK,
    SNAP_ACROSS,
    SNAP_ALONG,
    SUMMED,
    TURNED,
    TURNED_MORE,
)
from sdm.kernels.winding.rims.radial_strips import (
    DERIVATIVES,
    LARGEST_RATIO,
    LOOK_OF_SUMS,
    MET_ACROSS,
    NEAREST_EDGE,
    SUMS_OF_LOOK,
    Look,
)

wp.set_module_options({"enable_backward": False})

# Numbers of sixteen edges: both ends, their distance, one over that, zero if it is too small, and how often they are
# met: once or twice, as the edges are between faces that are turned to either side.
BEGIN, END, LENGTH, PER_LENGTH, TIMES, ROW = (SIXTEEN * number for number in (0, 3, 6, 7, 8, 9))
SHORTEST = 1.0e-15


@wp.func
def place_of_edge(number: int):
    """Place of the first of an edge's numbers."""
    return ROW * (number / SIXTEEN) + number % SIXTEEN


@wp.func
def pack_in_rows(boundary: Boundary, mesh: int, first: int, rows: wp.array(dtype=wp.float32)):
    """Write a mesh's edges in rows of sixteen, from the first one on; returns how many edges there are in them.

    Two that are alike and next to each other are one that is met twice.
    """
    length = int(0)
    before_a = wp.vec3()
    before_b = wp.vec3()
    times = float(2.0)
    for e in range(edges_of(boundary)):
        end = 2 * (mesh * boundary.count + e)
        a = boundary.ends[end]
        b = boundary.ends[end + 1]
        if times == 1.0 and a == before_a and b == before_b:
            times = float(2.0)
            number = first * SIXTEEN + length - 1
            rows[place_of_edge(number) + TIMES] = times
        else:
            times = float(1.0)
            number = first * SIXTEEN + length
            at = place_of_edge(number)
            for axis in range(3):
                rows[at + BEGIN + SIXTEEN * axis] = a[axis]
                rows[at + END + SIXTEEN * axis] = b[axis]
            long = wp.length(b - a)
            inverse = float(0.0)
            if long > SHORTEST:
                inverse = 1.0 / long
            rows[at + LENGTH] = long
            rows[at + PER_LENGTH] = inverse
            rows[at + TIMES] = times
            length = length + 1
        before_a = a
        before_b = b
    # No row is written in part: edges without a length, far from all voxels.
    padded = int(length)
    while padded % SIXTEEN != 0:
        at = place_of_edge(first * SIXTEEN + padded)
        for k in range(ROW / SIXTEEN):
            rows[at + SIXTEEN * k] = 1000.0
        padded = padded + 1
    return length


@wp.kernel
def pack_edges(
    begin: int, boundary: Boundary, blocks: int, rows: wp.array(dtype=wp.float32), packed: wp.array(dtype=wp.int32)
):
    """Write up to `blocks` rows of sixteen edges for each mesh, and how many edges are packed there."""
    mesh = begin + wp.tid()
    packed[mesh] = pack_in_rows(boundary, mesh, mesh * blocks, rows)


# As many edges as a register holds, as they are seen from a place `c`, and which of them are there.
EDGES = f"""
        T ga[3], gb[3], length, per_length, times;
        const float* row = rows.data + {ROW} * (size_t)(first + WIDE * i / {SIXTEEN}) + WIDE * i % {SIXTEEN};
        for (int k = 0; k < 3; ++k) {{
            __builtin_memcpy(&ga[k], row + {BEGIN} + {SIXTEEN} * k, sizeof(T));
            __builtin_memcpy(&gb[k], row + {END} + {SIXTEEN} * k, sizeof(T));
        }}
        __builtin_memcpy(&length, row + {LENGTH}, sizeof(T));
        __builtin_memcpy(&per_length, row + {PER_LENGTH}, sizeof(T));
        __builtin_memcpy(&times, row + {TIMES}, sizeof(T));
        const M there = numbers < M{{}} + (count - WIDE * i), twice = there & (times > one);
        const T ax = ga[0] - c.c[0], ay = ga[1] - c.c[1], az = ga[2] - c.c[2];
        const T bx = gb[0] - c.c[0], by = gb[1] - c.c[1], bz = gb[2] - c.c[2];
        const T ex = gb[0] - ga[0], ey = gb[1] - ga[1], ez = gb[2] - ga[2];
        const T aside_a = ay * ay + az * az, aside_b = by * by + bz * bz, yz = ay * by + az * bz;
        const T la = root(ax * ax + aside_a), lb = root(bx * bx + aside_b), both = la + lb;
        const T one_way = ay * ez, other_way = az * ey, nx = one_way - other_way;
        // The strip along -x, see `rims.float32_sum`.
        const T far_a = la + size_of(ax), far_b = lb + size_of(bx);
        const M up_a = ax > none, up_b = bx > none;
        const T across_a = where(up_a, far_a, one), across_b = where(up_b, far_b, one), scale = across_a * across_b;
        const T ss = where(up_a, aside_a, far_a) * where(up_b, aside_b, far_b);
        const T x = ss + yz * scale, y = -nx * scale, sx = size_of(x), sy = size_of(y), most = most_of(sx, sy);
"""
TURN = f"""
        {{
            const T snap = both * scale;
            const T dx = {PARTS}f * (ss + size_of(yz) * scale + sy) + {SNAP_ALONG}f * snap;
            const T dy = {ACROSS}f * scale * (size_of(one_way) + size_of(other_way)) + {SNAP_ACROSS}f * snap;
            const M known = (most > 10.0f * (dx + dy)) & (most < all({LARGEST}f)) & ((x > none) | (sy > dy));
            const T inverse = about(most), part = sy * inverse;
            const T off = {SECOND}f * inverse * (part * dx + dy) + ({TURNED_MORE}f * part + {TURNED}f);
            error = error + where(there, where(known, times * off, unknown), none);
            const T u = x * inverse, v = y * inverse;
            auto turn = [&](T u, T v) {{
                const T new_re = re * u - im * v, new_im = re * v + im * u;
                // By the signs of three numbers: over the negative half line one way, or the other.
                const M below = (M)im, below_now = (M)new_im, back = (M)v;
                crossings += (M)((U)(~below & ~back & below_now) >> 31);
                crossings -= (M)((U)(below & back & ~below_now) >> 31);
                re = new_re;
                im = new_im;
            }};
            turn(u, v);
            if (any(twice)) turn(where(twice, u, one), where(twice, v, none));
            if (i % 16 == 15) {{
                const T shrink = where(size_of(re) + size_of(im) > all({LARGEST_PRODUCT}f), all({SHRINK}f), one);
                re = re * shrink;
                im = im * shrink;
            }}
        }}
"""
BEGIN_SUMS = """
    M numbers;
    for (int k = 0; k < WIDE; ++k) numbers[k] = k;
    T re = one, im = none, error = none;
    M crossings = {};
"""
# What is not known may be no number.
END_SUMS = f"""
    const M sure = error < unknown;
    const T turns = where(sure, __builtin_convertvector(crossings, T), none);
    re = where(sure, re, one);
    im = where(sure, im, none);
    // The product of them all, so that one argument is enough, by halves of what is left.
    T turned = turns;
    const T size_of_it = about(most_of(size_of(re), size_of(im)));
    re = re * size_of_it;
    im = im * size_of_it;
    for (int half = WIDE / 2; half > 0; half /= 2) {{
        T other_re, other_im;
        for (int k = 0; k < WIDE; ++k) {{
            other_re[k] = re[(k + half) % WIDE];
            other_im[k] = im[(k + half) % WIDE];
        }}
        const T new_re = re * other_re - im * other_im, new_im = re * other_im + im * other_re;
        const M below = (M)im, other_below = (M)other_im, below_now = (M)new_im;
        M crossed = (M)((U)(~below & ~other_below & below_now) >> 31);
        crossed -= (M)((U)(below & other_below & ~below_now) >> 31);
        for (int k = 0; k < WIDE; ++k) crossed[k] = k < half ? crossed[k] : 0;
        turned = turned + __builtin_convertvector(crossed, T);
        re = new_re;
        im = new_im;
    }}
    float all_turns = 0.0f, all_errors = 0.0f;
    for (int k = 0; k < WIDE; ++k) {{ all_turns += turned[k]; all_errors += error[k]; }}
    const float angle = atan2f(im[0], re[0]) + {2.0 * wp.PI}f * all_turns;
    const float share = angle * {1.0 / (2.0 * wp.PI)}f;
    const float off = (all_errors + {SUMMED}f * (WIDE + fabsf(angle))) * {1.0 / (2.0 * wp.PI)}f;
"""
# Which edges are far for a ball about `c`, and the derivatives of those, as `cap_taylor.add_edge` has them.
FAR = f"""const T ny = az * ex - ax * ez, nz = ax * ey - ay * ex;
        const T flat = root(nx * nx + ny * ny + nz * nz);
        const T d = 0.999f * most_of(flat * per_length, 0.5f * (both - length)) - 1.0e-6f * both;
        const T per_d = about(d), rho = radius * per_d, reach = least(length * per_d, all(1.5707964f));
        const T size = la * lb, k = size + ax * bx + yz;
        const T bound = reach * (rho * rho) * (rho * rho) * (1.0f + rho + 2.0f * rho * rho);
        const M far = there & (d > all({NEAREST_EDGE}f * radius)) & (k * {LARGEST_RATIO}f > size)
            & (bound <= all(tolerance));
        if (any(far)) {{
            const T fla = where(far, la, one), flb = where(far, lb, one), fk = where(far, k, one);
            const T part = where(far, times, none), fx = part * nx, fy = part * ny, fz = part * nz;
            const T pair = fla * flb, inv = per(pair * fk);
            const T ia = inv * flb * fk, ib = inv * fla * fk, ik = inv * pair;
            const T w = ia + ib, s1 = w * ik, sum = fla + flb;
            const T once = sum * ik * ik, pull = w * once, ia2 = ia * ia, ib2 = ib * ib;
            const T fa = ia * (ia2 * ik + pull), fb = ib * (ib2 * ik + pull);
            const T sx = ax * fa + bx * fb, sy = ay * fa + by * fb, sz = az * fa + bz * fb;
            const T common = w * ik * ik * (2.0f * sum * sum * ik - 1.0f);
            {DERIVATIVES}
            const T squared = (size_of(sx) + size_of(sy) + size_of(sz)) * square;
            const T change = s1 * radius + squared + cube * (p + 2.0f * q + r - 3.0f * level);
"""
ADD = f"""const T off = change * (20.0f * fla * length + flat * (20.0f * pair * ik + 40.0f)) + 2.0f * reach * per_d;
            slope[0] = slope[0] + s1 * fx;
            slope[1] = slope[1] + s1 * fy;
            slope[2] = slope[2] + s1 * fz;
            const T hx2 = 0.5f * fx, hy2 = 0.5f * fy, hz2 = 0.5f * fz;
            squares[0] = squares[0] + hx2 * sx;
            squares[1] = squares[1] + hy2 * sy;
            squares[2] = squares[2] + hz2 * sz;
            products[0] = products[0] + (hx2 * sy + hy2 * sx);
            products[1] = products[1] + (hx2 * sz + hz2 * sx);
            products[2] = products[2] + (hy2 * sz + hz2 * sy);
            const float sixth = 1.0f / 6.0f;
            const T mx = fx * sixth, my = fy * sixth, mz = fz * sixth;
            cubes[0] = cubes[0] + mx * xx;
            cubes[1] = cubes[1] + (my * xx + mx * xy);
            cubes[2] = cubes[2] + (mz * xx + mx * xz);
            cubes[3] = cubes[3] + (mx * yy + my * xy);
            cubes[4] = cubes[4] + (mx * yz2 + my * xz + mz * xy);
            cubes[5] = cubes[5] + my * yy;
            cubes[6] = cubes[6] + (mz * yy + my * yz2);
            drift = drift + where(far, part * change * flat, none);
            bounds = bounds + where(far, part * ({1.0006}f * bound + {UNIT}f * off), none);
            steps = steps + where(far, one, none);
"""
MET = f"""// Strips along -x across the box: a line and a rectangle, seen along x.
        const T snap = 2.0e-6f * (1.0f + both);
        {MET_ACROSS}
"""
LISTS = """const M near_here = there & ~far;
        if (any(near_here | met)) {
            for (unsigned left = bits_of(near_here); left; left &= left - 1, ++near)
                if (near < room) stack.data[near_at + near] = WIDE * i + __builtin_ctz(left);
            for (unsigned left = bits_of(met); left; left &= left - 1, ++across)
                if (across < room_across) stack.data[across_at + across] = WIDE * i + __builtin_ctz(left);
        }
"""
LOOK_ALONE = LOOK_OF_SUMS.replace(SHARES, "")


@wp.func_native(
    snippet=f"""
    {WIDEST_NUMBERS}
    wp::vec_t<23, float> found;
#if !defined(__CUDA_ARCH__)
    {BEGIN_SUMS}
    {SUMS_OF_LOOK}
    const float room_y = half.c[1] * 1.0001f, room_z = half.c[2] * 1.0001f;
    for (int i = 0; WIDE * i < count; ++i) {{
        {EDGES}
        {TURN}
        {FAR}
            {ADD}
        }}
        {MET}
        {LISTS}
    }}
    {END_SUMS}
    {LOOK_ALONE}
#endif
    return found;
"""
)
def look_at_eights(
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
) -> Look:
    """`look_at_edges` of `rims.radial_strips` by packed edges, whose first row and number are given; they are listed by
    their numbers there.
    """
    ...


@wp.func_native(
    snippet=f"""
    {WIDEST_NUMBERS}
#if !defined(__CUDA_ARCH__)
    {BEGIN_SUMS}
    for (int i = 0; WIDE * i < count; ++i) {{
        {EDGES}
        {TURN}
    }}
    {END_SUMS}
    return wp::vec2(share, off);
#else
    return wp::vec2(0.0f, 0.0f);
#endif
"""
)
def sum_of_eights(rows: wp.array(dtype=wp.float32), first: int, count: int, c: wp.vec3) -> wp.vec2:
    """`rim_sum` of `rims.float32_sum` by packed edges: the share of the winding number at c, and its largest error."""
    ...
