"""Solid angles of listed nodes and caps at all voxels of a box of 4^3 on a CPU: `node_angles` for its eight octants.

Each node is read once for the whole box, and added to as many voxels at once as a CPU has registers for, of the octants
that it is far for. To others its caps are added one by one.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.wide_numbers import ANGLE_OF, OFF_ANGLE, SIXTEEN, WIDEST_NUMBERS
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE
from sdm.kernels.winding.eights.box_strips import ERROR, SHARE, VOXELS, X, Y, Z
from sdm.kernels.winding.eights.node_angles import CAP, FAR_NODE, FEWER
from sdm.kernels.winding.eights.node_table import EIGHT_ROWS, EXACT, LEAST, LISTED, ROOM, ROW
from sdm.kernels.winding.near_caps import FULL, LARGEST_PRODUCT, UNIT, WIDER

wp.set_module_options({"enable_backward": False})

_NODES = EIGHT_ROWS.replace("T ", "Eight ")


@wp.func_native(
    snippet=f"""
    {WIDEST_NUMBERS}
#if !defined(__CUDA_ARCH__)
    {ANGLE_OF}
    typedef float Eight __attribute__((vector_size(32)));
    typedef int Eights __attribute__((vector_size(32)));
    typedef bool EightBits __attribute__((ext_vector_type(8)));
    auto byte_of = [](Eights m) {{
        return (unsigned long long)__builtin_bit_cast(unsigned char, __builtin_convertvector(m, EightBits));
    }};
    constexpr int GROUPS = 64 / WIDE;
    wp::int32* const nodes = stack.data + at;
    float* const voxels = places.data + at_places;
    auto group = [&](int g) {{ return voxels + {VOXELS} * (WIDE * g / {SIXTEEN}) + WIDE * g % {SIXTEEN}; }};
    T xs[GROUPS], ys[GROUPS], zs[GROUPS], sum[GROUPS], total[GROUPS];
    // Of two octants in a group, the voxels of one, of the other, or of both.
    M own[4];
    for (int which = 0; which < 4; ++which)
        for (int n = 0; n < WIDE; ++n) own[which][n] = which >> (n >> 1 & 1) & 1 ? -1 : 0;
    float middle[3][8], radius[8];
    for (int e = 0; e < 8; ++e) {{
        const float* const first = voxels + {VOXELS} * (e >> 1) + 2 * (e & 1);
        float far2 = 0.0f;
        for (int axis = 0; axis < 3; ++axis)
            middle[axis][e] = 0.5f * (first[{SIXTEEN} * axis] + first[{SIXTEEN} * axis + 13]);
        for (int n = 0; n < 8; ++n) {{
            float away2 = 0.0f;
            for (int axis = 0; axis < 3; ++axis) {{
                const float off = first[{SIXTEEN} * axis + 4 * (n >> 1) + (n & 1)] - middle[axis][e];
                away2 += off * off;
            }}
            far2 = far2 < away2 ? away2 : far2;
        }}
        radius[e] = sqrtf(far2) * {WIDER * 1.000001}f;
    }}
    for (int g = 0; g < GROUPS; ++g) {{
        __builtin_memcpy(&xs[g], group(g) + {X}, sizeof(T));
        __builtin_memcpy(&ys[g], group(g) + {Y}, sizeof(T));
        __builtin_memcpy(&zs[g], group(g) + {Z}, sizeof(T));
        sum[g] = total[g] = none;
    }}
    Eight errors[8] = {{}}, drifts[8] = {{}};
    unsigned unsure = 0;
    int near = 0;
    for (int first_of_turn = 0; first_of_turn < listed; first_of_turn += 8) {{
        int some[8];
        const float* row[8];
        for (int k = 0; k < 8; ++k) {{
            some[k] = nodes[{LISTED} + (first_of_turn + k < listed ? first_of_turn + k : first_of_turn)];
            row[k] = rows.data + {ROW} * (size_t)(base + some[k]);
        }}
        {_NODES}
        const int many = listed - first_of_turn < 8 ? listed - first_of_turn : 8;
        const Eights numbers = {{0, 1, 2, 3, 4, 5, 6, 7}}, there = numbers < Eights{{}} + many;
        // Of each octant, which nodes are far; then of each node, for which octants.
        unsigned long long far = 0;
        for (unsigned left = octants; left; left &= left - 1) {{
            const int e = __builtin_ctz(left);
            const Eight cx = v[0] - middle[0][e], cy = v[1] - middle[1][e], cz = v[2] - middle[2][e];
            Eight distance = cx * cx + cy * cy + cz * cz;
            for (int k = 0; k < 8; ++k) distance[k] = __builtin_sqrtf(distance[k]);
            const Eight gap = distance - radius[e], space = gap - v[3], cube = gap * gap * gap;
            const Eight room = cube * space * space;
            const Eights apart = there & (space > {0.5 * LEAST}f * distance) & (v[7] <= {WIDER}f * tolerance * room);
            const Eight per = 1.0f / (apart ? room : 1.0f + Eight{{}});
            const Eight off = per * (v[7] + (v[5] - {FEWER}f * v[4]) * cube), drift = per * v[4] * cube;
            errors[e] += apart ? off : Eight{{}};
            drifts[e] += apart ? drift : Eight{{}};
            far |= byte_of(apart) << (8 * e);
        }}
        // The transpose of a matrix of bits.
        unsigned long long swapped = (far ^ (far >> 7)) & 0x00aa00aa00aa00aaull;
        far ^= swapped ^ (swapped << 7);
        swapped = (far ^ (far >> 14)) & 0x0000cccc0000ccccull;
        far ^= swapped ^ (swapped << 14);
        swapped = (far ^ (far >> 28)) & 0x00000000f0f0f0f0ull;
        far ^= swapped ^ (swapped << 28);
        for (int k = 0; k < many; ++k) {{
            const int node = some[k];
            const unsigned in = far >> (8 * k) & 255, rest = octants & ~in;
            if (rest) {{
                const long long leaf = node - leaves;
                if (leaf < 0 || near >= {ROOM // 2}) unsure |= rest;
                else {{
                    nodes[{EXACT} + 2 * near] = 4 * (first + (int)((leaf * count) >> depth));
                    nodes[{EXACT} + 2 * near + 1] = (int)rest;
                    ++near;
                }}
            }}
            if (in) {{
                const float* m = moments.data + {MOMENTS_SIZE} * (size_t)(base + node);
                for (int g = 0; g < GROUPS; ++g) {{
                    const unsigned both = in >> (2 * (WIDE * g / {SIXTEEN})) & 3;
                    if (!both) continue;
                    const T px = xs[g], py = ys[g], pz = zs[g];
                    {FAR_NODE}
                    sum[g] = sum[g] + where(own[both], share, none);
                }}
            }}
        }}
        // Sums of few, so that none is of many numbers.
        if (first_of_turn % 32 == 24) {{
            for (int g = 0; g < GROUPS; ++g) {{
                total[g] = total[g] + sum[g];
                sum[g] = none;
            }}
        }}
    }}
    float bounds[8];
    for (int e = 0; e < 8; ++e) {{
        float bound = 0.0f, drift = 0.0f;
        for (int k = 0; k < 8; ++k) {{
            bound += errors[e][k];
            drift += drifts[e][k];
        }}
        bounds[e] = bound + {1.1 * UNIT}f * ((float)(listed / 32) + 40.0f) * drift;
        if (unsure >> e & 1) bounds[e] = INFINITY;
    }}
    for (int g = 0; g < GROUPS; ++g) {{
        const int pair = WIDE * g / {SIXTEEN};
        if (!(octants >> (2 * pair) & 3)) continue;
        const T px = xs[g], py = ys[g], pz = zs[g];
        T re = one, im = none, error = none;
        M turns = {{}};
        bool single = false;
        for (int i = 0; i < near; ++i) {{
            const M wanted = own[nodes[{EXACT} + 2 * i + 1] >> (2 * pair) & 3];
            if (!(nodes[{EXACT} + 2 * i + 1] >> (2 * pair) & 3)) continue;
            single = true;
            const auto* corner = corners.data + nodes[{EXACT} + 2 * i];
            {CAP}
            error = error + where(wanted, off, none);
            const T x = where(known & wanted, f * scale, one), y = where(known & wanted, v * scale, none);
            const T new_re = re * x - im * y, new_im = re * y + im * x;
            // By the signs of three numbers: over the negative half line one way, or the other.
            const M below = (M)im, below_now = (M)new_im, back = (M)y;
            turns += (M)((U)(~below & ~back & below_now) >> 31);
            turns -= (M)((U)(below & back & ~below_now) >> 31);
            re = new_re;
            im = new_im;
            if (i % 32 == 31) {{
                const T shrink = where(size_of(re) + size_of(im) > all({LARGEST_PRODUCT}f),
                    all(1.0f / {LARGEST_PRODUCT}f), one);
                re = re * shrink;
                im = im * shrink;
            }}
        }}
        T bound, angle = none;
        for (int n = 0; n < WIDE; ++n) bound[n] = bounds[2 * pair + (n >> 1 & 1)];
        if (single) {{
            angle = 2.0f * angle_of(re, im) + {FULL}f * __builtin_convertvector(turns, T);
            bound = bound + {2.0 * OFF_ANGLE}f;
        }}
        const T far_share = sum[g] + total[g], share = (angle + far_share) * {1.0 / FULL}f;
        const T wrong = (error + bound + {4.0 * UNIT}f * (size_of(angle) + size_of(far_share))) * {1.0 / FULL}f;
        __builtin_memcpy(group(g) + {SHARE}, &share, sizeof(T));
        __builtin_memcpy(group(g) + {ERROR}, &wrong, sizeof(T));
    }}
#endif
"""
)
def nodes_of_box(
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
    octants: int,
    tolerance: float,
    places: wp.array(dtype=wp.float32),
    at_places: int,
):
    """Write the shares of listed nodes and caps of the winding numbers at the voxels of some octants of a box of 4^3,
    and their largest errors; `box_voxels` says where voxels are. Others as `node_angles.angles_of_nodes` has them.
    """
    ...
