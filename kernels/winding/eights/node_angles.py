"""Solid angles of listed nodes and single caps of an open mesh, seen from eight voxels at once on a CPU."""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.wide_numbers import NUMBERS
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE
from sdm.kernels.winding.eight_voxels import Eight, Sixteen
from sdm.kernels.winding.eights.node_table import EIGHT_ROWS, EXACT, LEAST, LISTED, ROW
from sdm.kernels.winding.near_caps import FULL, LARGEST_PRODUCT, ROUNDINGS, SNAP, UNIT, WIDER

wp.set_module_options({"enable_backward": False})

# So much less than a field has, by area, does rounding add to what a node adds to a voxel.
FEWER = 200.0 * UNIT


# What a far node, with moments m, adds at places; and a single cap: f + iv, whose argument is half of what that adds,
# what it is to be taken times, `scale`, if it is `known`, and its error `off`.
FAR_NODE = """
                const T x = m[0] - px, y = m[1] - py, z = m[2] - pz;
                const T x2 = x * x, y2 = y * y, z2 = z * z, i2 = one / (x2 + y2 + z2), i1 = root(i2);
                const T p = x2 - z2, q = y2 - z2, two = z2 + z2, xy = x * y;
                const T line = m[7] * x + m[8] * y + m[9] * z;
                const T square = m[10] * p + m[13] * q + 2.0f * (m[11] * xy + z * (m[12] * x + m[14] * y));
                const T cubic = x * (m[15] * (p - two) + (3.0f * m[18]) * q)
                    + y * (m[20] * (q - two) + (3.0f * m[16]) * p)
                    + z * (m[17] * (3.0f * p + two) + m[21] * (3.0f * q + two) + (6.0f * m[19]) * xy);
                const T share = i1 * i2 * (line + i2 * (7.5f * i2 * cubic - 3.0f * square));
"""
CAP = f"""
        const T ax = corner[0].c[0] - px, ay = corner[0].c[1] - py, az = corner[0].c[2] - pz;
        const T bx = corner[1].c[0] - px, by = corner[1].c[1] - py, bz = corner[1].c[2] - pz;
        const T cx = corner[2].c[0] - px, cy = corner[2].c[1] - py, cz = corner[2].c[2] - pz;
        const T la = root(ax * ax + ay * ay + az * az);
        const T lb = root(bx * bx + by * by + bz * bz);
        const T lc = root(cx * cx + cy * cy + cz * cz);
        const T size = la * lb * lc;
        const T v = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx);
        const T f = size + (ax * bx + ay * by + az * bz) * lc + (bx * cx + by * cy + bz * cz) * la
            + (cx * ax + cy * ay + cz * az) * lb;
        const T shortest = least(least(la, lb), lc), sv = size_of(v), sf = size_of(f), most = most_of(sv, sf);
        const T room = ({ROUNDINGS}f * shortest + {SNAP}f) * size;
        const M known = (most * shortest > 10.0f * room) & ((f > none) | (sv * shortest > room));
        const T inverse = one / (most * shortest);
        const T off = where(known, {2.0 * WIDER}f * (room * inverse), unknown), scale = inverse * shortest;
"""


@wp.func_native(
    snippet=f"""
    {NUMBERS}
    wp::vec_t<16, float> found;
#if !defined(__CUDA_ARCH__)
    wp::int32* const nodes = stack.data + at;
    T px, py, pz, sum = none, total = none;
    for (int k = 0; k < 8; ++k) {{ px[k] = xs.c[k]; py[k] = ys.c[k]; pz[k] = zs.c[k]; }}
    const float wide = radius * {WIDER}f;
    const M numbers = {{0, 1, 2, 3, 4, 5, 6, 7}};
    T errors = none, drifts = none;
    int near = 0;
    for (int first_of_turn = 0; first_of_turn < listed; first_of_turn += 8) {{
        int some[8];
        const float* row[8];
        for (int k = 0; k < 8; ++k) {{
            some[k] = nodes[{LISTED} + (first_of_turn + k < listed ? first_of_turn + k : first_of_turn)];
            row[k] = rows.data + {ROW} * (size_t)(base + some[k]);
        }}
        {EIGHT_ROWS}
        const T cx = v[0] - centre.c[0], cy = v[1] - centre.c[1], cz = v[2] - centre.c[2];
        const T distance = root(cx * cx + cy * cy + cz * cz), gap = distance - wide, left = gap - v[3];
        const T cube = gap * gap * gap, room = cube * left * left;
        const M there = numbers < M{{}} + (listed - first_of_turn);
        const M apart = there & (left > {0.5 * LEAST}f * distance) & (v[7] <= {WIDER}f * tolerance * room);
        const int far = bits_of(apart);
        int rest = bits_of(there);
        if (far) {{
            const T per = one / where(apart, room, one);
            errors = errors + where(apart, per * (v[7] + (v[5] - {FEWER}f * v[4]) * cube), none);
            drifts = drifts + where(apart, per * v[4] * cube, none);
        }}
        while (rest) {{
            const int k = __builtin_ctz(rest);
            rest &= rest - 1;
            const int node = some[k];
            if (far >> k & 1) {{
                const float* m = moments.data + {MOMENTS_SIZE} * (size_t)(base + node);
                {FAR_NODE}
                sum = sum + share;
            }} else {{
                const long long leaf = node - leaves;
                if (leaf < 0) errors = unknown;
                else nodes[{EXACT} + near++] = 4 * (first + (int)((leaf * count) >> depth));
            }}
        }}
        // Sums of few, so that none is of many numbers.
        if (first_of_turn % 32 == 24) {{
            total = total + sum;
            sum = none;
        }}
    }}
    float bounds = 0.0f, drift = 0.0f;
    for (int k = 0; k < 8; ++k) {{
        bounds += errors[k];
        drift += drifts[k];
    }}
    bounds += {1.1 * UNIT}f * ((float)(listed / 32) + 40.0f) * drift;
    sum = sum + total;
    // Single caps, as `eight_voxels.near_angles` has them.
    T re = one, im = none, turns = none, error = none;
    for (int i = 0; i < near; ++i) {{
        const auto* corner = corners.data + nodes[{EXACT} + i];
        {CAP}
        error = error + off;
        const T x = where(known, f * scale, one), y = where(known, v * scale, none);
        const T new_re = re * x - im * y, new_im = re * y + im * x;
        const M below = im < none, below_now = new_im < none;
        turns = turns + where(~below & (y > none) & below_now, one, none);
        turns = turns - where(below & (y < none) & ~below_now, one, none);
        re = new_re;
        im = new_im;
        if (i % 32 == 31) {{
            const T shrink = where(size_of(re) + size_of(im) > all({LARGEST_PRODUCT}f),
                all(1.0f / {LARGEST_PRODUCT}f), one);
            re = re * shrink;
            im = im * shrink;
        }}
    }}
    for (int k = 0; k < 8; ++k) {{
        const float angle = near ? 2.0f * atan2f(im[k], re[k]) + {FULL}f * turns[k] : 0.0f;
        found.c[k] = angle + sum[k];
        found.c[8 + k] = error[k] + bounds + {4.0 * UNIT}f * (fabsf(angle) + fabsf(sum[k]));
    }}
#endif
    return found;
"""
)
def angles_of_nodes(
    moments: wp.array(dtype=wp.float32),
    rows: wp.array(dtype=wp.float32),
    base: int,
    leaves: int,
    corners: wp.array(dtype=wp.vec3),
    first: int,
    count: int,
    depth: int,
    stack: wp.array(dtype=wp.int32),
    at: int,
    listed: int,
    centre: wp.vec3,
    radius: float,
    tolerance: float,
    xs: Eight,
    ys: Eight,
    zs: Eight,
) -> Sixteen:
    """Solid angles of listed nodes and caps seen from eight voxels (scaled) of a ball, and then their largest errors.

    Args:
        moments: As `see_nodes` has them.
        rows: As there.
        base: As there.
        leaves: As there.
        corners: Of caps, see `Tree`.
        first: The slot of the mesh's first cap.
        count: The mesh's caps.
        depth: Levels below the root of their tree.
        stack: With the list of `see_nodes` for a ball around this one, and the same tolerance.
        at: Where this worker's begin.
        listed: The length of the list.
        centre: Of the ball around the voxels.
        radius: Of that.
        tolerance: What a node may add to the error.
        xs: Of the voxels.
        ys: Of the voxels.
        zs: Of the voxels.
    """
    ...
