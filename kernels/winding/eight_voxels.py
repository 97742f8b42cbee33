"""Solid angles of near caps from eight voxels at once, on a CPU, which has registers for eight numbers."""

from __future__ import annotations

import warp as wp

from sdm.kernels.geometry.voxel_grid import Slab, voxel
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.near_caps import (
    ACROSS,
    ALONG,
    FULL,
    LARGEST_PRODUCT,
    NEAR_LIST,
    SECOND,
    SNAP_ACROSS,
    SNAP_ALONG,
    TURNED,
    TURNED_MORE,
    UNIT,
)

wp.set_module_options({"enable_backward": False})

Eight = wp.types.vector(length=8, dtype=wp.float32)
Sixteen = wp.types.vector(length=16, dtype=wp.float32)


# `near_angle` of a single lane, for eight points at once: a CPU has registers for as many numbers.
@wp.func_native(
    snippet=f"""
    wp::vec_t<16, float> found;
#if !defined(__CUDA_ARCH__)
    typedef float eight __attribute__((vector_size(32)));
    typedef int mask __attribute__((vector_size(32)));
    auto load = [](const wp::vec_t<8, float>& x) {{ eight e; for (int k = 0; k < 8; ++k) e[k] = x.c[k]; return e; }};
    auto all = [](float x) {{ return eight{{x, x, x, x, x, x, x, x}}; }};
    auto where = [](mask m, eight x, eight y) {{ return (eight)((m & (mask)x) | (~m & (mask)y)); }};
    auto root = [](eight x) {{ for (int k = 0; k < 8; ++k) x[k] = __builtin_sqrtf(x[k]); return x; }};
    auto size_of = [](eight x) {{ return (eight)((mask)x & 0x7fffffff); }};
    const eight px = load(xs), py = load(ys), pz = load(zs), none = all(0.0f), one = all(1.0f);
    eight re = one, im = none, turns = none, error = none;
    for (int i = 0; i < near; ++i) {{
        // Products and sums as one operation, with one rounding: nobody wants these bits again.
        #pragma clang fp contract(fast)
        const auto* at = corners.data + stack.data[{NEAR_LIST} + i];
        const eight ax = at[0].c[0] - px, ay = at[0].c[1] - py, az = at[0].c[2] - pz;
        const eight bx = at[1].c[0] - px, by = at[1].c[1] - py, bz = at[1].c[2] - pz;
        const eight cx = at[2].c[0] - px, cy = at[2].c[1] - py, cz = at[2].c[2] - pz;
        const eight la = root(ax * ax + ay * ay + az * az);
        const eight lb = root(bx * bx + by * by + bz * bz);
        const eight lc = root(cx * cx + cy * cy + cz * cz);
        const eight size = la * lb * lc;
        const float dx = at[1].c[0] - at[0].c[0], dy = at[1].c[1] - at[0].c[1], dz = at[1].c[2] - at[0].c[2];
        const float ex = at[2].c[0] - at[0].c[0], ey = at[2].c[1] - at[0].c[1], ez = at[2].c[2] - at[0].c[2];
        const float first = fabsf(dx) + fabsf(dy) + fabsf(dz), second = fabsf(ex) + fabsf(ey) + fabsf(ez);
        const eight v = ax * (dy * ez - dz * ey) + ay * (dz * ex - dx * ez) + az * (dx * ey - dy * ex);
        const eight f = size + (ax * bx + ay * by + az * bz) * lc + (bx * cx + by * cy + bz * cz) * la
            + (cx * ax + cy * ay + cz * az) * lb;
        const eight less = where(la < lb, la, lb), least = where(less < lc, less, lc);
        const eight sv = size_of(v), sf = size_of(f), most = where(sv < sf, sf, sv);
        const eight more = where(la > lb, la, lb), longest = where(more > lc, more, lc);
        const eight across = ({ACROSS}f * first * second * la + {SNAP_ACROSS}f * (first + second) * longest) * least;
        const eight along = ({ALONG}f * least + {SNAP_ALONG}f) * size, room = along + across;
        const mask known = (most * least > 10.0f * room) & ((f > none) | (sv * least > room));
        const eight inverse = one / (most * least);
        const eight x = where(known, f * (inverse * least), one), y = where(known, v * (inverse * least), none);
        const eight part = size_of(y), off = {2.0 * SECOND}f * inverse * (part * along + across);
        error = error + where(known, off + ({2.0 * TURNED_MORE}f * part + {2.0 * TURNED}f), all(INFINITY));
        const eight new_re = re * x - im * y, new_im = re * y + im * x;
        turns = turns + where((im >= none) & (y > none) & (new_im < none), one, none);
        turns = turns - where((im < none) & (y < none) & (new_im >= none), one, none);
        re = new_re;
        im = new_im;
        // A factor is between 1 and 1.5: this is long before an overflow.
        if (i % 32 == 31) {{
            const mask large = size_of(re) + size_of(im) > all({LARGEST_PRODUCT}f);
            const eight shrink = where(large, all(1.0f / {LARGEST_PRODUCT}f), one);
            re = re * shrink;
            im = im * shrink;
        }}
    }}
    for (int k = 0; k < 8; ++k) {{
        const float angle = 2.0f * atan2f(im[k], re[k]) + {FULL}f * turns[k];
        found.c[k] = angle;
        found.c[8 + k] = error[k] + {4.0 * UNIT}f * fabsf(angle);
    }}
#endif
    return found;
"""
)
def near_angles(
    corners: wp.array(dtype=wp.vec3), near: int, xs: Eight, ys: Eight, zs: Eight, stack: wp.array(dtype=wp.int32)
) -> Sixteen:
    """On a CPU, the solid angles of the listed caps seen from eight points (scaled), and then their largest errors."""
    ...


@wp.func
def place_in_box(number: int, bits: int):
    """The place of a voxel in a box of 2^bits along each edge."""
    return wp.vec3i(number >> (2 * bits), (number >> bits) & ((1 << bits) - 1), number & ((1 << bits) - 1))


@wp.func
def eight_angles(
    caps: Caps,
    near: int,
    slab: Slab,
    start: wp.vec3i,
    bits: int,
    number: int,
    scale: float,
    stack: wp.array(dtype=wp.int32),
):
    """`near_angles` from eight voxels of a box."""
    xs = Eight()
    ys = Eight()
    zs = Eight()
    for other in range(8):
        v = start + place_in_box(number + other, bits)
        p = scale * voxel(slab, v[0], v[1], v[2])
        xs[other] = p[0]
        ys[other] = p[1]
        zs[other] = p[2]
    return near_angles(caps.tree.corners, near, xs, ys, zs, stack)
