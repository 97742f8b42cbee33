"""Solid angles of single near caps, one by one: exactly, with the largest error of float32."""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import first_triangle, tree_of
from sdm.kernels.primitives.fast_math import about_root
from sdm.kernels.winding.cap_tree import Caps

wp.set_module_options({"enable_backward": False})

FULL = 4.0 * wp.PI
# Room for the rounding of a bound.
WIDER = 1.0001
UNIT = 2.0**-24
# The errors of a near cap's half solid angle, see `near_cap`.
ROUNDINGS = 100.0 * UNIT
LARGEST_PRODUCT = 1.0e9
SNAP = 2.0 * UNIT
# And of one in a sum, see `near_angle`: of v by its edges and by places on the lattice, and of f by both; of a
# quotient's second order; and of a product's rounding.
ACROSS, SNAP_ACROSS, ALONG, SNAP_ALONG = 12.0 * UNIT, 0.25 * UNIT, 70.0 * UNIT, 1.4 * UNIT
SECOND, TURNED, TURNED_MORE = 1.3, 3.0 * UNIT, 8.0 * UNIT
# The place in a large stack where near caps are listed, and on a GPU the room there for each lane of a part.
NEAR_LIST = 768
NEAR_EACH = 20


@wp.func
def cap_factor(a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """f, v and s of `near_cap`, and the least of the lengths."""
    la = about_root(wp.dot(a, a))
    lb = about_root(wp.dot(b, b))
    lc = about_root(wp.dot(c, c))
    size = la * lb * lc
    v = wp.dot(a, wp.cross(b, c))
    f = size + wp.dot(a, b) * lc + wp.dot(b, c) * la + wp.dot(c, a) * lb
    return f, v, size, wp.min(la, wp.min(lb, lc))


@wp.func
def is_known(f: float, v: float, most: float, room: float, least: float):
    """True if an angle is known to within its bound.

    A product of lengths that underflows is in doubt; so is what overflows, or is not a number.
    """
    return most * least > 10.0 * room and (f > 0.0 or wp.abs(v) * least > room)


@wp.func
def near_cap(a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """The solid angle of a triangle with corners at a, b and c from the point, and the largest error of it.

    Half of it is the argument of f + iv, where v = a.(b x c) and f = |a||b||c| + a.b|c| + b.c|a| + c.a|b| (van
    Oosterom and Strackee 1983). In units of s = |a||b||c| and u = 2^-24: a, b and c are differences of float32 numbers,
    each rounded once, and lengths have errors of at most 4u; v then has an error of at most 14u, f of at most 65u. The
    places on the lattice, which are those that count, are up to 0.1u away: that moves f + iv by 1.3u over the least of
    the lengths. So the argument is right within (100u + 2u/least) s/|f + iv|, if that is small and the negative real
    axis, where it jumps by a turn, is further away; else nothing is known.
    """
    f, v, size, least = cap_factor(a, b, c)
    most = wp.max(wp.abs(v), wp.abs(f))
    room = (ROUNDINGS * least + SNAP) * size
    error = float(wp.inf)
    angle = float(0.0)
    if is_known(f, v, most, room, least):
        error = 2.0 * room / (most * least)
        angle = 2.0 * wp.atan2(v, f)
    return angle, error


@wp.func
def place_of_cap(caps: Caps, mesh: int, leaf: int):
    """The place of the first corner of the cap in a leaf of a mesh's tree, by which near caps are listed."""
    one = tree_of(caps.tree, mesh)
    return 4 * (one.first + first_triangle(one, leaf))


@wp.func
def corners_from(caps: Caps, place: int, p: wp.vec3):
    """The ways from p (scaled) to the corners of the cap whose first one is at a place."""
    return caps.tree.corners[place] - p, caps.tree.corners[place + 1] - p, caps.tree.corners[place + 2] - p


@wp.func
def near_list_of(lane: int, some: int):
    """The place in a large stack where a lane's part of a group, of so many neighbours, lists near caps."""
    return NEAR_LIST + NEAR_EACH * (lane - (lane & (some - 1)))


# Native text: roots and quotients.
TOOLS = """
#if defined(__CUDA_ARCH__)
    auto root = [](float x) { float y; asm("sqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x)); return y; };
    auto inverse_of = [](float x) { float y; asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x)); return y; };
    auto less_of = [](float x, float y) { return fminf(x, y); };
    auto bits_of = [](float x) { return __float_as_int(x); };
#else
    auto root = [](float x) { return sqrtf(x); };
    auto inverse_of = [](float x) { return 1.0f / x; };
    auto less_of = [](float x, float y) { return x < y ? x : y; };
    auto bits_of = [](float x) { int bits; __builtin_memcpy(&bits, &x, 4); return bits; };
#endif
"""
# The cap whose first corner is at `place`: its corners, the product n of two edges, and what v may be off by for these:
# so much for the length of the way to the first corner, of which none of the others differs by more than the edges do,
# and so much anyway.
CAP = f"""
#if defined(__CUDA_ARCH__)
        const float4* row = reinterpret_cast<const float4*>(corners.data) + 3 * (place >> 2);
        const float4 r0 = __ldg(row), r1 = __ldg(row + 1), r2 = __ldg(row + 2);
        const float x0 = r0.x, y0 = r0.y, z0 = r0.z, x1 = r0.w, y1 = r1.x, z1 = r1.y, x2 = r1.z, y2 = r1.w, z2 = r2.x;
#else
        const auto* row = corners.data + place;
        const float x0 = row[0].c[0], y0 = row[0].c[1], z0 = row[0].c[2];
        const float x1 = row[1].c[0], y1 = row[1].c[1], z1 = row[1].c[2];
        const float x2 = row[2].c[0], y2 = row[2].c[1], z2 = row[2].c[2];
#endif
        const float dx = x1 - x0, dy = y1 - y0, dz = z1 - z0, ex = x2 - x0, ey = y2 - y0, ez = z2 - z0;
        const float nx = dy * ez - dz * ey, ny = dz * ex - dx * ez, nz = dx * ey - dy * ex;
        const float first = fabsf(dx) + fabsf(dy) + fabsf(dz), second = fabsf(ex) + fabsf(ey) + fabsf(ez);
        const float both = {SNAP_ACROSS}f * (first + second);
        const float rounded = {ACROSS}f * first * second + both, snapped = both * (first + second);
"""
# That cap, seen from (px, py, pz): f, v and the least of the lengths, what f and v may be off by, times that, and
# whether that is little.
SEEN = f"""
        const float ax = x0 - px, ay = y0 - py, az = z0 - pz;
        const float bx = x1 - px, by = y1 - py, bz = z1 - pz;
        const float cx = x2 - px, cy = y2 - py, cz = z2 - pz;
        const float la = root(ax * ax + ay * ay + az * az);
        const float lb = root(bx * bx + by * by + bz * bz);
        const float lc = root(cx * cx + cy * cy + cz * cz);
        const float size = la * lb * lc, v = ax * nx + ay * ny + az * nz;
        const float f = size + (ax * bx + ay * by + az * bz) * lc + (bx * cx + by * cy + bz * cz) * la
            + (cx * ax + cy * ay + cz * az) * lb;
        const float least = less_of(la, less_of(lb, lc));
        const float scale = -less_of(-fabsf(v), -fabsf(f)) * least;
        const float across = (rounded * la + snapped) * least;
        const float along = ({ALONG}f * least + {SNAP_ALONG}f) * size, room = along + across;
        const bool known = (scale > 10.0f * room) & ((f > 0.0f) | (fabsf(v) * least > room));
        const float inverse = inverse_of(scale), part = inverse * least;
"""
# A factor of the product of all.
FACTOR = f"""
        const float x = known ? f * part : 1.0f, y = known ? v * part : 0.0f, turned = fabsf(y);
        const float rounding = {2.0 * TURNED_MORE}f * turned + {2.0 * TURNED}f;
        const float off = {2.0 * SECOND}f * inverse * (turned * along + across) + rounding;
        error = known ? error + off : INFINITY;
        const float new_re = re * x - im * y, new_im = re * y + im * x;
        // Past the negative real axis the imaginary part changes its sign from that of the factor's.
        const int before = bits_of(im), after = bits_of(new_im);
        turns += ((before >> 31) | 1) & ((~(before ^ bits_of(y)) & (before ^ after)) >> 31);
        re = new_re;
        im = new_im;
"""


@wp.func_native(
    snippet=f"""
    {TOOLS}
    const float px = p.c[0], py = p.c[1], pz = p.c[2];
    float re = 1.0f, im = 0.0f, error = 0.0f;
    int turns = 0;
#if defined(__CUDA_ARCH__)
    const int here = threadIdx.x & 31, mine = here & (sharing - 1);
    float4* rows = reinterpret_cast<float4*>(stack.data) + 4 * (here - mine);
    for (int begin = 0; __any_sync(0xffffffffu, begin < near); begin += sharing) {{
        __syncwarp();
        if (begin + mine < near) {{
            const int place = stack.data[at + begin + mine];
            {CAP}
            rows[4 * mine] = make_float4(x0, y0, z0, rounded);
            rows[4 * mine + 1] = make_float4(x1, y1, z1, snapped);
            rows[4 * mine + 2] = make_float4(x2, y2, z2, nx);
            rows[4 * mine + 3] = make_float4(ny, nz, 0.0f, 0.0f);
        }}
        __syncwarp();
        const int end = active ? min(sharing, near - begin) : 0;
        for (int i = lane; i < end; i += lanes) {{
            const float4 r0 = rows[4 * i], r1 = rows[4 * i + 1], r2 = rows[4 * i + 2];
            const float2 r3 = *reinterpret_cast<const float2*>(rows + 4 * i + 3);
            const float x0 = r0.x, y0 = r0.y, z0 = r0.z, x1 = r1.x, y1 = r1.y, z1 = r1.z;
            const float x2 = r2.x, y2 = r2.y, z2 = r2.z;
            const float nx = r2.w, ny = r3.x, nz = r3.y, rounded = r0.w, snapped = r1.w;
            {SEEN}
            {FACTOR}
        }}
        // A factor is between 1 and 1.5, and these are up to 32: this is long before an overflow.
        const float shrink = fabsf(re) + fabsf(im) > {LARGEST_PRODUCT}f ? {1.0 / LARGEST_PRODUCT}f : 1.0f;
        re *= shrink;
        im *= shrink;
    }}
#else
    for (int i = lane; active && i < near; i += lanes) {{
        const int place = stack.data[at + i];
        {CAP}
        {SEEN}
        {FACTOR}
        const float shrink = fabsf(re) + fabsf(im) > {LARGEST_PRODUCT}f ? {1.0 / LARGEST_PRODUCT}f : 1.0f;
        re *= shrink;
        im *= shrink;
    }}
#endif
    const float angle = 2.0f * atan2f(im, re) + {FULL}f * (float)turns;
    return wp::vec2(angle, error + {4.0 * UNIT}f * fabsf(angle));
"""
)
def near_sum(
    corners: wp.array(dtype=wp.vec3),
    near: int,
    active: bool,
    p: wp.vec3,
    stack: wp.array(dtype=wp.int32),
    at: int,
    lane: int,
    lanes: int,
    sharing: int,
) -> wp.vec2:
    """`near_angle`, as a pair."""
    ...


@wp.func
def near_angle(
    caps: Caps,
    near: int,
    active: bool,
    p: wp.vec3,
    stack: wp.array(dtype=wp.int32),
    at: int,
    lane: int,
    lanes: int,
    sharing: int,
):
    """A lane's part of the solid angle of the caps listed at a place, seen from p (scaled), and the error it may have.

    All lanes of a group have to ask, of which so many neighbours share a list (`sharing`, a power of two), and so many
    of these a point (`lanes`); some of them for nothing, if they are not active. Caps are read by one lane each, and
    then seen by all from the stack's first places.

    Half angles add up as the arguments of a product of complex numbers, and a count of its full turns. f is that of
    `near_cap`, and v = a.n, n = d x e with the edges d = b - a and e = c - a, so that many small caps leave little: in
    units of u = 2^-24, d and e are right within 1 of themselves, n within 6 |d||e|, and v within 10 |d||e||a|. Places
    on the lattice, 0.1 away, move v by 0.1 (|b x c| + |c x a| + |a x b|), which is less than 0.2 (|d| + |e|) times the
    longest of the ways, and f by 1.3 s over the least. The angle is off by what v is, over the larger of both, and by
    v's share of that of what f is. A factor and its product are rounded: by up to 3, and 8 times that share.
    """
    found = near_sum(caps.tree.corners, near, active, p, stack, at, lane, lanes, sharing)
    return found[0], found[1]
