"""Voxels of a box of 4^3 on a CPU, as many at once as it has registers for: where they are, and which of them a field
and what is near leave in no doubt.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.geometry.voxel_grid import Slab, voxel
from sdm.kernels.primitives.wide_numbers import SIXTEEN, WIDEST_NUMBERS
from sdm.kernels.winding.cap_field import ONE_OVER_FULL, Cubic, Field, cubic_of
from sdm.kernels.winding.eights.box_strips import ERROR, SHARE, VOXELS, X, Y, Z
from sdm.kernels.winding.settled_boxes import LAST_ROUNDING, LAST_ROUNDINGS

wp.set_module_options({"enable_backward": False})

# Behind eight bits, of the octants of a box that have voxels left in doubt, there is how many they are.
OCTANTS = 256

# The voxels of a box lie in 16 rows of four along z, four of which are two octants: where a row is along x and y.
_OF_ROW = "const int i = 2 * (row >> 3) + (row >> 1 & 1), j = 2 * (row >> 2 & 1) + (row & 1);"


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    float* const voxels = places.data + at;
    for (int row = 0; row < 16; ++row) {{
        {_OF_ROW}
        float* const to = voxels + {VOXELS} * (row >> 2) + 4 * (row & 3);
        for (int k = 0; k < 4; ++k) {{
            to[{X} + k] = xs.c[i];
            to[{Y} + k] = ys.c[j];
            to[{Z} + k] = zs.c[k];
        }}
    }}
#endif
"""
)
def write_straight(places: wp.array(dtype=wp.float32), at: int, xs: wp.vec4, ys: wp.vec4, zs: wp.vec4):
    """Write places that have one of four coordinates along each axis."""
    ...


@wp.func
def write_voxels(slab: Slab, start: wp.vec3i, scale: float, places: wp.array(dtype=wp.float32), at: int):
    """Write where the voxels of a box of 4^3 are (scaled), as `strips_of_box` wants it."""
    if slab.turned == 0:
        xs = wp.vec4()
        ys = wp.vec4()
        zs = wp.vec4()
        for k in range(4):
            p = scale * voxel(slab, start[0] + k, start[1] + k, start[2] + k)
            xs[k] = p[0]
            ys[k] = p[1]
            zs[k] = p[2]
        write_straight(places, at, xs, ys, zs)
    else:
        for number in range(64):
            row = number >> 2
            v = start + wp.vec3i(2 * (row >> 3) + ((row >> 1) & 1), 2 * ((row >> 2) & 1) + (row & 1), number & 3)
            p = scale * voxel(slab, v[0], v[1], v[2])
            to = at + VOXELS * (number >> 4) + (number & 15)
            places[to + X] = p[0]
            places[to + Y] = p[1]
            places[to + Z] = p[2]


@wp.func_native(
    snippet=f"""
    {WIDEST_NUMBERS}
    int undone = 0;
#if !defined(__CUDA_ARCH__)
    const int rows = WIDE / 4;
    auto load = [&](const float* from) {{ T x; __builtin_memcpy(&x, from, sizeof(T)); return x; }};
    const bool full = within.c[0] >= 4 && within.c[1] >= 4 && within.c[2] >= 4;
    for (int g = 0; g < 64 / WIDE; ++g) {{
        float* at_row[rows];
        T whole = all(0.5f);
        for (int r = 0; r < rows; ++r) {{
            const int row = rows * g + r;
            {_OF_ROW}
            at_row[r] = (float*)((char*)values.data + mesh * (long long)values.strides[0]
                + (start.c[0] + i) * (long long)values.strides[1] + (start.c[1] + j) * (long long)values.strides[2]
                + start.c[2] * (long long)values.strides[3]);
            if (full) __builtin_memcpy((float*)&whole + 4 * r, at_row[r], 16);
            else if (i < within.c[0] && j < within.c[1])
                for (int k = 0; k < 4 && k < within.c[2]; ++k) whole[4 * r + k] = at_row[r][k];
        }}
        const M left = __builtin_convertvector(__builtin_convertvector(whole, M), T) == whole;
        if (!any(left)) continue;
        T share = all(middle), wrong = all(change);
        if (!plain) {{
            const float* const of = places.data + at + {VOXELS} * (WIDE * g / {SIXTEEN}) + WIDE * g % {SIXTEEN};
            const T x = load(of + {X}) - c.c[0], y = load(of + {Y}) - c.c[1], z = load(of + {Z}) - c.c[2];
            const T xx = x * x, yy = y * y, zz = z * z;
            // As `cap_field.share_at` has it.
            const T curved = squares.c[0] * xx + squares.c[1] * yy + squares.c[2] * zz
                + x * (products.c[0] * y + products.c[1] * z) + products.c[2] * (y * z);
            const float* q = cubes.c;
            const T cubic = x * (x * (q[0] * x + q[1] * y + q[2] * z) + y * (q[3] * y + q[4] * z))
                + yy * (q[6] * y + q[7] * z) + zz * (q[5] * x + q[8] * y + q[9] * z);
            share = share + (slope.c[0] * x + slope.c[1] * y + slope.c[2] * z + curved + cubic) * {ONE_OVER_FULL}f;
            if (listed) {{
                share = share + load(of + {SHARE});
                wrong = load(of + {ERROR});
            }} else wrong = none;
        }}
        const T winding = whole + sign * share;
        const T off = least(least(size_of(winding - 0.25f), size_of(winding - 0.5f)), size_of(winding - 0.75f));
        const T least_off = wrong + error + {LAST_ROUNDINGS}f + {LAST_ROUNDING}f * size_of(whole);
        const M sure = left & (off > least_off);
        const M is_whole = __builtin_convertvector(__builtin_convertvector(winding, M), T) == winding;
        const T to = where(sure, where(is_whole, winding + 0.0625f, winding), whole);
        for (int r = 0; r < rows; ++r) {{
            const int row = rows * g + r;
            {_OF_ROW}
            if (full) __builtin_memcpy(at_row[r], (const float*)&to + 4 * r, 16);
            else if (i < within.c[0] && j < within.c[1])
                for (int k = 0; k < 4 && k < within.c[2]; ++k) at_row[r][k] = to[4 * r + k];
        }}
        for (unsigned some = bits_of(left & ~sure); some; some &= some - 1) {{
            const int n = WIDE * g + __builtin_ctz(some);
            undone |= 1 << (2 * (n >> 4) + (n >> 1 & 1));
            undone += {OCTANTS};
        }}
    }}
#endif
    return undone;
"""
)
def settle_by_numbers(
    values: wp.array4d(dtype=wp.float32),
    mesh: int,
    start: wp.vec3i,
    within: wp.vec3i,
    places: wp.array(dtype=wp.float32),
    at: int,
    c: wp.vec3,
    middle: float,
    slope: wp.vec3,
    squares: wp.vec3,
    products: wp.vec3,
    cubes: Cubic,
    plain: bool,
    listed: bool,
    sign: float,
    error: float,
    change: float,
) -> int:
    """`settle_voxels` by numbers."""
    ...


@wp.func
def settle_voxels(
    field: Field,
    slab: Slab,
    values: wp.array4d(dtype=wp.float32),
    mesh: int,
    start: wp.vec3i,
    places: wp.array(dtype=wp.float32),
    at: int,
    c: wp.vec3,
    plain: bool,
    listed: bool,
    sign: float,
    change: float,
):
    """Open the voxels of a box of 4^3 that are left in no doubt; the octants that hold others, a bit for each, and
    OCTANTS times how many these are.

    Args:
        field: What is to be added to crossings, about `c`.
        slab: Of the mesh.
        values: Crossings, or winding numbers where voxels are open.
        mesh: The mesh's number.
        start: The first voxel.
        places: Where voxels are and, if something is `listed`, what that adds and its errors: see `strips_of_box`.
        at: Where they begin.
        c: See there.
        plain: True if the field's value is enough for all of the box, give or take `change`.
        listed: See `places`.
        sign: Of what is added, 1 or -1.
        change: See `plain`.
    """
    within = slab.shape - start
    return settle_by_numbers(
        values, mesh, start, within, places, at, c, float(field.value) * ONE_OVER_FULL, field.slope, field.squares,
        field.products, cubic_of(field.cubes), plain, listed, sign, field.error * ONE_OVER_FULL, change,
    )  # fmt: skip


@wp.func_native(
    snippet=f"""
    int found = 0;
#if !defined(__CUDA_ARCH__)
    for (int row = 0; row < 16; ++row) {{
        {_OF_ROW}
        if (i >= within.c[0] || j >= within.c[1]) continue;
        const float* const at_row = (const float*)((const char*)values.data + mesh * (long long)values.strides[0]
            + (start.c[0] + i) * (long long)values.strides[1] + (start.c[1] + j) * (long long)values.strides[2]
            + start.c[2] * (long long)values.strides[3]);
        for (int k = 0; k < 4 && k < within.c[2]; ++k)
            if ((float)(int)at_row[k] == at_row[k]) found |= 1 << (2 * (row >> 2) + (k >> 1));
    }}
#endif
    return found;
"""
)
def octants_left(values: wp.array4d(dtype=wp.float32), mesh: int, start: wp.vec3i, within: wp.vec3i) -> int:
    """The octants of a box of 4^3, a bit for each, that have voxels which are not open yet; `within` is how many voxels
    there are from `start` on.
    """
    ...


@wp.func
def sixteens_left(values: wp.array4d(dtype=wp.float32), mesh: int, start: wp.vec3i, within: wp.vec3i):
    """The pairs of those octants, sixteen voxels each, that have such voxels, a bit for each."""
    octants = octants_left(values, mesh, start, within)
    pairs = octants | (octants >> 1)
    return (pairs & 1) | ((pairs >> 1) & 2) | ((pairs >> 2) & 4) | ((pairs >> 3) & 8)
