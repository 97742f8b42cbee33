"""Nodes of the tree of caps near a box of voxels, on a CPU: far ones go into a field, others are added to eight voxels.

A field (`cap_field`) asks for a node whose distance is large for its radius and the box's together. At a single voxel
only the node's counts: with u the way from the voxel to its centre, D = |u|, and M1, M2, M3 its moments, the caps under
it fill

    M1.u / D^3 - 3 u.M2 u / D^5 + 7.5 M3 u u u / D^7,

and what that leaves out (the terms of the third order on, see `cap_field` with R = 0) is at most

    area mean of |y|^3 / D^5 (4 - 3 rho) / (1 - rho)^2 <= 4 area r sigma^2 / (D^3 (D - r)^2),

as the mean of |y|^3 is at most r sigma^2. Rounding, in units of u = 2^-24: the three terms are wrong by 19, by 150 rho
and by 500 rho^2 times area / D^2 at most, which is less than 60 area / (D - r)^2; and together they are no more than
area / (D - r)^2 in size, of which so many are added up.

So nodes that are as large as a box of voxels, but not as near, are neither opened nor near. Eight voxels, which a CPU's
registers hold, are a box of 2^3, for which the distance is the least. Single caps for which that is too much are added
exactly (`eight_voxels`).
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.wide_numbers import NUMBERS
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE
from sdm.kernels.winding.eights.node_table import (
    EIGHT_ROWS,
    HAND_DOWN,
    HANDED,
    LEAST,
    NEAREST,
    ROOM,
    ROW,
    SMALL,
    TO_VOXELS,
)
from sdm.kernels.winding.near_caps import UNIT, WIDER

wp.set_module_options({"enable_backward": False})

Seen = wp.types.vector(length=22, dtype=wp.float32)
# Places in it: a field's numbers, the value in two parts, the nodes added to it, and those that were listed.
SLOPE, SQUARES, PRODUCTS, CUBES, ERROR, DRIFT, STEPS, LENGTH, HIGH, LOW = 0, 3, 6, 9, 16, 17, 18, 19, 20, 21


# Adds eight nodes to a field, those of `m` that are among the first so many.
_ADD_NODES = f"""
    auto add = [&](int many) {{
        T v[32];
        for (int part = 0; part < 4; ++part) {{
            const float* row[8];
            for (int k = 0; k < 8; ++k) {{
                const int node = far_nodes[k < many ? k : 0];
                row[k] = moments.data + {MOMENTS_SIZE} * (size_t)(base + node) + 8 * part;
            }}
            {{
                T* const all_numbers = v + 8 * part;
                {EIGHT_ROWS.replace("v[", "w[").replace("T w[8];", "T w[8];")}
                for (int k = 0; k < 8; ++k) all_numbers[k] = w[k];
            }}
        }}
        const M is_there = numbers < M{{}} + many;
        const T x = v[0] - centre.c[0], y = v[1] - centre.c[1], z = v[2] - centre.c[2];
        const T i2 = where(is_there, one / (x * x + y * y + z * z), none), i = root(i2);
        const T i3 = i2 * i, i4 = i2 * i2, i5 = i4 * i;
        const T a = x * i, b = y * i, c = z * i, aa = a * a, bb = b * b, cc = c * c;
        const T ab = 2.0f * a * b, ac = 2.0f * a * c, bc = 2.0f * b * c;
        const T p0 = v[7], p1 = v[8], p2 = v[9], xx = v[10], xy = v[11], xz = v[12], yy = v[13];
        const T yz = v[14], zz = -xx - yy, s5 = -v[15] - v[18], s8 = -v[16] - v[20], s9 = -v[17] - v[21];
        const T d = p0 * a + p1 * b + p2 * c;
        const T v0 = xx * a + xy * b + xz * c, v1 = xy * a + yy * b + yz * c, v2 = xz * a + yz * b + zz * c;
        const T q = (v0 * a + v1 * b + v2 * c) * i;
        const T w0 = i2 * (aa * v[15] + ab * v[16] + ac * v[17] + bb * v[18] + bc * v[19] + cc * s5);
        const T w1 = i2 * (aa * v[16] + ab * v[18] + ac * v[19] + bb * v[20] + bc * v[21] + cc * s8);
        const T w2 = i2 * (aa * v[17] + ab * v[19] + ac * s5 + bb * v[21] + bc * s8 + cc * s9);
        const T e = w0 * a + w1 * b + w2 * c;
        // As `fourth_moment.quartic_at` has it.
        const T even = v[22] * (aa * (aa - 6.0f * cc) + cc * cc) + v[29] * (bb * (bb - 6.0f * cc) + cc * cc)
            + v[25] * (6.0f * (aa * bb - (aa + bb) * cc) + 2.0f * cc * cc);
        const T odd = 2.0f * ab * (v[23] * (aa - 3.0f * cc) + v[27] * (bb - 3.0f * cc))
            + 2.0f * ac * (v[24] * (aa - cc) + v[28] * (3.0f * bb - cc));
        const T g = even + odd + 2.0f * bc * (v[26] * (3.0f * aa - cc) + v[30] * (bb - cc));
        const T shares = i2 * (d - 3.0f * q + 7.5f * e - 17.5f * (i3 * g));
        for (int k = 0; k < 8; ++k) value += (double)shares[k];
        const T k = 3.0f * d - 15.0f * q + 52.5f * e, six = 6.0f * i;
        slope[0] = slope[0] + i3 * (a * k - p0 + six * v0 - 22.5f * w0);
        slope[1] = slope[1] + i3 * (b * k - p1 + six * v1 - 22.5f * w1);
        slope[2] = slope[2] + i3 * (c * k - p2 + six * v2 - 22.5f * w2);
        const T u = 7.5f * d - 52.5f * q, thirty = 30.0f * i, plain = 1.5f * d - 7.5f * q, third = 3.0f * i;
        const T t0 = u * a - 3.0f * p0 + thirty * v0, t1 = u * b - 3.0f * p1 + thirty * v1;
        const T t2 = u * c - 3.0f * p2 + thirty * v2;
        squares[0] = squares[0] + i4 * (t0 * a - plain - third * xx);
        squares[1] = squares[1] + i4 * (t1 * b - plain - third * yy);
        squares[2] = squares[2] + i4 * (t2 * c - plain - third * zz);
        products[0] = products[0] + i4 * (t0 * b + t1 * a - 2.0f * third * xy);
        products[1] = products[1] + i4 * (t0 * c + t2 * a - 2.0f * third * xz);
        products[2] = products[2] + i4 * (t1 * c + t2 * b - 2.0f * third * yz);
        const T f = 17.5f * d, h = 7.5f * d;
        const T a0 = f * a - 7.5f * p0, a1 = f * b - 7.5f * p1, a2 = f * c - 7.5f * p2;
        const T b0 = 1.5f * p0 - h * a, b1 = 1.5f * p1 - h * b, b2 = 1.5f * p2 - h * c;
        cubes[0] = cubes[0] + i5 * (a0 * aa + b0);
        cubes[1] = cubes[1] + i5 * (a1 * aa + a0 * ab + b1);
        cubes[2] = cubes[2] + i5 * (a2 * aa + a0 * ac + b2);
        cubes[3] = cubes[3] + i5 * (a0 * bb + a1 * ab + b0);
        cubes[4] = cubes[4] + i5 * (a0 * bc + a1 * ac + a2 * ab);
        cubes[5] = cubes[5] + i5 * (a1 * bb + b1);
        cubes[6] = cubes[6] + i5 * (a2 * bb + a1 * bc + b2);
    }};
"""


@wp.func_native(
    snippet=f"""
    {NUMBERS}
    wp::vec_t<22, float> found;
#if !defined(__CUDA_ARCH__)
    const M numbers = {{0, 1, 2, 3, 4, 5, 6, 7}};
    wp::int32* const nodes = stack.data + at;
    double value = 0.0;
    T slope[3], squares[3], products[3], cubes[7], errors = none, drifts = none;
    for (int k = 0; k < 3; ++k) slope[k] = squares[k] = products[k] = none;
    for (int k = 0; k < 7; ++k) cubes[k] = none;
    float error = 0.0f;
    int far_nodes[16], waiting = 0, done = 0, listed = 0, far_count = 0, steps = 0;
    const int total = handed < 0 ? 1 : handed;
    const float wide = radius * {WIDER}f;
    {_ADD_NODES}
    while (waiting > 0 || done < total) {{
        int some[8], many = 0;
        const float* row[8];
        while (many < 8 && waiting > 0) some[many++] = nodes[--waiting];
        while (many < 8 && done < total) {{
            some[many++] = handed < 0 ? 1 : nodes[{HANDED} + done];
            ++done;
        }}
        for (int k = many; k < 8; ++k) some[k] = some[0];
        for (int k = 0; k < 8; ++k) row[k] = rows.data + {ROW} * (size_t)(base + some[k]);
        {EIGHT_ROWS}
        const T x = v[0] - centre.c[0], y = v[1] - centre.c[1], z = v[2] - centre.c[2];
        const T r = v[3], area = v[4], sigma = v[6], distance = root(x * x + y * y + z * z);
        const T gap = distance - wide, left = gap - r, left2 = left * left;
        const int there = bits_of((v[5] > none) & (numbers < M{{}} + many));
        const M apart = (left > {LEAST}f * distance) & (distance > all({NEAREST}f));
        int far = 0, spread = 0;
        if (mode != {TO_VOXELS}) {{
            // As `cap_descent.rest_of` has it.
            const T inverse = one / distance, rho = wide * inverse + r * inverse;
            const T wide_off = inverse * radius, size = inverse * r, mean = inverse * sigma;
            const T square = mean * mean, off2 = wide_off * wide_off;
            const T fourth = off2 * (off2 + 4.0f * wide_off * mean + 6.0f * square)
                + square * size * (4.0f * wide_off + size);
            const T part = {WIDER}f * area * (5.0f - 4.0f * rho) * fourth;
            const M taken = apart & (part <= tolerance * left2);
            far = bits_of(taken) & there;
            if (far) {{
                const T per = one / left2;
                const M mask = (M{{}} + far & M{{1, 2, 4, 8, 16, 32, 64, 128}}) != 0;
                errors = errors + where(mask, per * (part + v[5]), none);
                drifts = drifts + where(mask, wide_off * area * per, none);
            }}
        }}
        if (mode != {HAND_DOWN}) {{
            spread = bits_of(apart & (v[7] <= tolerance * gap * gap * gap * left2)) & there & ~far;
        }}
        const int large = mode == {HAND_DOWN} ? bits_of(r > all({SMALL}f * radius)) : 255;
        int rest = there & ~far;
        while (rest) {{
            const int k = __builtin_ctz(rest);
            rest &= rest - 1;
            const int node = some[k];
            if (((large & ~spread) >> k & 1) && node < leaves) {{
                nodes[waiting] = 2 * node;
                nodes[waiting + 1] = 2 * node + 1;
                waiting += 2;
            }} else {{
                if (listed < {ROOM}) nodes[listed_at + listed] = node;
                ++listed;
            }}
        }}
        steps += __builtin_popcount(far);
        while (far) {{
            const int k = __builtin_ctz(far);
            far &= far - 1;
            far_nodes[far_count++] = some[k];
        }}
        if (far_count >= 8) {{
            add(8);
            far_count -= 8;
            for (int k = 0; k < far_count; ++k) far_nodes[k] = far_nodes[8 + k];
        }}
        if (listed > {ROOM} || waiting > {HANDED - 16}) {{
            error = INFINITY;
            break;
        }}
    }}
    if (far_count) add(far_count);
    auto sum = [&](T x) {{ float s = 0.0f; for (int k = 0; k < WIDE; ++k) s += get(x, k); return s; }};
    for (int k = 0; k < 3; ++k) {{
        found.c[{SLOPE} + k] = sum(slope[k]);
        found.c[{SQUARES} + k] = sum(squares[k]);
        found.c[{PRODUCTS} + k] = sum(products[k]);
    }}
    for (int k = 0; k < 7; ++k) found.c[{CUBES} + k] = sum(cubes[k]);
    const float drift = sum(drifts);
    found.c[{ERROR}] = error + {WIDER}f * sum(errors) + {4.0 * UNIT}f * ((float)steps + 6.0f) * drift;
    found.c[{DRIFT}] = drift;
    found.c[{STEPS}] = (float)steps;
    found.c[{LENGTH}] = (float)listed;
    found.c[{HIGH}] = (float)value;
    found.c[{LOW}] = (float)(value - (double)(float)value);
#endif
    return found;
"""
)
def see_nodes(
    moments: wp.array(dtype=wp.float32),
    rows: wp.array(dtype=wp.float32),
    base: int,
    leaves: int,
    stack: wp.array(dtype=wp.int32),
    at: int,
    handed: int,
    centre: wp.vec3,
    radius: float,
    tolerance: float,
    mode: int,
    listed_at: int,
) -> Seen:
    """The field of the far nodes about a ball, of those under `handed` nodes, or of all if that is negative; and a list
    of the others: to be handed down, or of nodes and single caps to be added to voxels.

    Args:
        moments: Of nodes, of which the mesh's first one has the number `base`.
        rows: Of `pack_nodes`.
        base: See there.
        leaves: The mesh's leaves.
        stack: Of STACK numbers for each worker.
        at: Where this worker's begin.
        handed: How many nodes are handed down to this ball.
        centre: Of the ball.
        radius: Of the ball.
        tolerance: What a node may add to the error of the solid angle.
        mode: HAND_DOWN, MIXED or TO_VOXELS.
        listed_at: The place of the list, HANDED or LISTED.
    """
    ...
