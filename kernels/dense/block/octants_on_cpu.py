"""Measuring of a block's features on a CPU, one after the other, eight voxels at once.

As `octant_tests` and `min_values` have it, bit for bit, but without queues, which are for lanes that share work, and
without a branch between tests, as a CPU guesses wrong which of them fails. In the place of the block's witness each
octant has one of its own, a point of the listed triangles near its middle: see `octant_tests`, whose test it is. Where
many features are about as far as the surface (loose triangles, sheets through each other) the directions of
`voronoi_features` say little, and this leaves a third.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, load_corners
from sdm.kernels.culling.voronoi_features import Features, one_of
from sdm.kernels.culling.witness_bound import LARGEST_SQUARE, OFF_SURFACE, SLACK, bulge_of_edge
from sdm.kernels.dense.block.feature_setup import CORNER_KIND, EDGE_KIND, FACE_KIND, add_corner, add_edge, add_face
from sdm.kernels.dense.block.min_values import CORNER_TEXT, FACE_TEXT, FAR_EDGE_TEXT, NEAR_EDGE_TEXT
from sdm.kernels.dense.block.shared_layout import (
    BATCH,
    COORDINATES,
    LATTICE_ROW,
    MIN_VALUES,
    PAIRS,
    TEST_ROW,
)
from sdm.kernels.dense.block.voxels import Block
from sdm.kernels.dense.block.winners import BlockOutput
from sdm.kernels.dense.chunk_pool import CandidateLists, ChunkPool, read_entry, read_on, start_reading
from sdm.kernels.primitives.fast_math import FUSED

wp.set_module_options({"enable_backward": False})

# Numbers of eight octants, in the place of the queues: their witnesses, the square of how far these are from their
# middles, half of what a witness beats; then where octants begin and end along each axis; and where eighths do in
# either half of a block, and where their voxels are.
AT = PAIRS // 4
WITNESS, SQUARE, LIMIT, LOW, HIGH = AT, AT + 24, AT + 32, AT + 40, AT + 64
EIGHTH, VOXEL, END = AT + 88, AT + 184, AT + 280

_TYPES = """
    typedef float T __attribute__((ext_vector_type(8)));
    typedef int M __attribute__((ext_vector_type(8)));
    typedef bool Bits __attribute__((ext_vector_type(8)));
    float* const number = reinterpret_cast<float*>(scratch);
    auto load = [&](int at) { T x; __builtin_memcpy(&x, number + at, 32); return x; };
    auto keep = [&](int at, T x) { __builtin_memcpy(number + at, &x, 32); };
    auto bits_of = [](M m) {
        return (int)__builtin_bit_cast(unsigned char, __builtin_convertvector(m, Bits));
    };
"""


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {_TYPES}
    const float* const x = number + {COORDINATES};
    const float* const y = x + 8;
    const float* const z = x + 16;
    for (int end = 0; end < 2; ++end) {{
        const float* p = x + 3 * end;
        const float* q = y + 3 * end;
        const float* r = z + 3 * end;
        const int to = end ? {HIGH} : {LOW};
        keep(to, T{{p[0], p[0], p[0], p[0], p[4], p[4], p[4], p[4]}});
        keep(to + 8, T{{q[0], q[0], q[4], q[4], q[0], q[0], q[4], q[4]}});
        keep(to + 16, T{{r[0], r[4], r[0], r[4], r[0], r[4], r[0], r[4]}});
    }}
    for (int half = 0; half < 2; ++half) {{
        for (int k = 0; k < 2; ++k) {{
            const float* p = x + 4 * half + k;
            const float* q = y + 4 * half + k;
            const float* r = z + 4 * half + k;
            const int to = {EIGHTH} + 16 * half + 8 * k;
            keep(to, T{{p[0], p[0], p[0], p[0], p[2], p[2], p[2], p[2]}});
            keep(to + 32, T{{q[0], q[0], q[2], q[2], q[0], q[0], q[2], q[2]}});
            keep(to + 64, T{{r[0], r[2], r[0], r[2], r[0], r[2], r[0], r[2]}});
            p += k; q += k; r += k;
            const int at = {VOXEL} + 16 * half + 8 * k;
            keep(at, T{{p[0], p[0], p[0], p[0], p[1], p[1], p[1], p[1]}});
            keep(at + 32, T{{q[0], q[0], q[1], q[1], q[0], q[0], q[1], q[1]}});
            keep(at + 64, T{{r[0], r[1], r[0], r[1], r[0], r[1], r[0], r[1]}});
        }}
    }}
    T square = {{}};
    for (int axis = 0; axis < 3; ++axis) {{
        const T off = 0.5f * (load({LOW} + 8 * axis) + load({HIGH} + 8 * axis)) - witness.c[axis];
        square += off * off;
        keep({WITNESS} + 8 * axis, T{{}} + witness.c[axis]);
    }}
    keep({SQUARE}, square);
#endif
"""
)
def begin_octants(scratch: wp.uint64, witness: wp.vec3):
    """Write where octants, eighths and voxels are, and one witness for all octants, from the block's centre."""
    ...


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {_TYPES}
    const float* const corner = reinterpret_cast<const float*>(corners.data) + 12 * (size_t)slot;
    float a[3], b[3], c[3], bb = 0.0f, bc = 0.0f, cc = 0.0f;
    T along_b = {{}}, along_c = {{}}, middle[3];
    for (int axis = 0; axis < 3; ++axis) {{
        a[axis] = corner[axis] - centre.c[axis];
        b[axis] = corner[3 + axis] - corner[axis];
        c[axis] = corner[6 + axis] - corner[axis];
        bb += b[axis] * b[axis];
        bc += b[axis] * c[axis];
        cc += c[axis] * c[axis];
        middle[axis] = 0.5f * (load({LOW} + 8 * axis) + load({HIGH} + 8 * axis));
        along_b += b[axis] * (middle[axis] - a[axis]);
        along_c += c[axis] * (middle[axis] - a[axis]);
    }}
    const float size = bb * cc - bc * bc, per = size > 0.0f ? 1.0f / size : 0.0f;
    T u = per * (cc * along_b - bc * along_c), v = per * (bb * along_c - bc * along_b);
    u = u > 0.0f ? u : T{{}};
    v = v > 0.0f ? v : T{{}};
    const T sum = u + v, less = 1.0f / (sum > 1.0f ? sum : T{{}} + 1.0f);
    T at[3], square = {{}};
    for (int axis = 0; axis < 3; ++axis) {{
        at[axis] = a[axis] + less * (u * b[axis] + v * c[axis]);
        square += (middle[axis] - at[axis]) * (middle[axis] - at[axis]);
    }}
    const T known = load({SQUARE});
    const M nearer = square < known;
    keep({SQUARE}, nearer ? square : known);
    for (int axis = 0; axis < 3; ++axis) {{
        keep({WITNESS} + 8 * axis, nearer ? at[axis] : load({WITNESS} + 8 * axis));
    }}
#endif
"""
)
def see_triangle(scratch: wp.uint64, corners: wp.array(dtype=wp.vec3), slot: int, centre: wp.vec3):
    """Take a point of a triangle for the witness of the octants to whose middles it is the nearest so far.

    Not the nearest of the triangle where that is on its rim, but one of it, however thin it is.
    """
    ...


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {_TYPES}
    const T x = load({WITNESS}), y = load({WITNESS + 8}), z = load({WITNESS + 16});
    auto size_of = [](T x) {{ return (T)((M)x & 0x7fffffff); }};
    const T square = x * x + y * y + z * z, squares = square + half2;
    // As `witness_bound.doubt` has it.
    const T doubt = {SLACK}f * squares + {OFF_SURFACE}f * diagonal * (size_of(x) + size_of(y) + size_of(z) + room);
    keep({LIMIT}, squares < {LARGEST_SQUARE}f ? 0.5f * (square + doubt) : T{{}} + INFINITY);
#endif
"""
)
def end_witnesses(scratch: wp.uint64, half2: float, diagonal: float, room: float):
    """Write what the octants' witnesses beat; `room` is the sum of the block's half-widths."""
    ...


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {_TYPES}
    T least = {{}};
    for (int axis = 0; axis < 3; ++axis) {{
        const T gap = load({WITNESS} + 8 * axis) - q.c[axis];
        const T low = gap * load({LOW} + 8 * axis), high = gap * load({HIGH} + 8 * axis);
        least += low < high ? low : high;
    }}
    const float more = 0.5f * (radius2 - (q.c[0] * q.c[0] + q.c[1] * q.c[1] + q.c[2] * q.c[2]));
    return 255 & ~bits_of(least > load({LIMIT}) + more);
#else
    return 0;
#endif
"""
)
def octants_near(scratch: wp.uint64, q: wp.vec3, radius2: float) -> int:
    """The octants, as bits, to some voxel of which a feature within a ball around q may be nearer than the witness."""
    ...


def _measure(feature: tuple[str, str]) -> str:
    """Native text that measures a feature in the eighths `there`: that of one voxel, with eight numbers in the place of
    one.
    """
    rows, own = feature
    for one, eight in (("const float ", "const T "), ("const bool counts = true;", ""), ("const bool ", "const M ")):
        own = own.replace(one, eight)
    own = own.replace("!(", "~(")
    counts = "" if feature is CORNER_TEXT else "least = counts ? least : known;"
    return f"""{{
        {rows}
        for (unsigned left = there; left; left &= left - 1) {{
            const int in = __builtin_ctz(left);
            const T x = load(at_x + (in << 1 & 8)), y = load(at_y + (in << 2 & 8)), z = load(at_z + (in << 3 & 8));
            T known;
            __builtin_memcpy(&known, best + 8 * in, 32);
            {own}
            T least = d < known ? d : known;
            {counts}
            __builtin_memcpy(best + 8 * in, &least, 32);
        }}
    }}"""


# Which of eight boxes, so many voxels apart, fail a test of directions.
_FAILED = """
    auto failed_tests = [&](const float* limits, float s) {
        const T is = {0, 0, 0, 0, s, s, s, s}, js = {0, 0, s, s, 0, 0, s, s}, ks = {0, s, 0, s, 0, s, 0, s};
        M failed = {};
        #pragma unroll
        for (int t = 0; t < 5; ++t)
            if (t < tests) failed |= limits[t] - is * ux[t] - js * uy[t] - ks * uz[t] < 0.0f;
        return failed;
    };
"""


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {FUSED}
    {_TYPES}
    struct alignas(16) Row {{ float x, y, z, w; }};
    const Row* row = reinterpret_cast<const Row*>(scratch);
    const int feature = 0, tests = 5 - kind;
    const float a = near ? 1.0f : 0.0f, b = 2.0f - a;
    const Row o = row[{LATTICE_ROW}], i = row[{LATTICE_ROW + 1}], j = row[{LATTICE_ROW + 2}];
    const Row k = row[{LATTICE_ROW + 3}];
    // The tests in steps of the lattice, all at once: see `octants_of`.
    const Row* test = row + {TEST_ROW};
    T vx, vy, vz, vw;
    #pragma unroll
    for (int t = 0; t < 8; ++t) {{
        const Row v = test[{BATCH} * (t < 5 ? t : 0)];
        vx[t] = v.x; vy[t] = v.y; vz[t] = v.z; vw[t] = v.w;
    }}
    auto size_of = [](T x) {{ return (T)((M)x & 0x7fffffff); }};
    const T wider = o.w * (size_of(vx) + size_of(vy) + size_of(vz));
    const T tx = FUSED(i.z, vz, FUSED(i.y, vy, i.x * vx)), ty = FUSED(j.z, vz, FUSED(j.y, vy, j.x * vx));
    const T tz = FUSED(k.z, vz, FUSED(k.y, vy, k.x * vx));
    const T less = 0.5f * (size_of(tx) + size_of(ty) + size_of(tz) - (tx + ty + tz));
    const T tw = vw + wider - FUSED(o.z, vz, FUSED(o.y, vy, o.x * vx)) + less, tleft = tw + 2.0f * less;
    float ux[8], uy[8], uz[8], lefts[8];
    __builtin_memcpy(ux, &tx, 32);
    __builtin_memcpy(uy, &ty, 32);
    __builtin_memcpy(uz, &tz, 32);
    __builtin_memcpy(lefts, &tleft, 32);
    {_FAILED}
    const float more = 0.5f * (radius2 - (q.c[0] * q.c[0] + q.c[1] * q.c[1] + q.c[2] * q.c[2]));
    for (unsigned some = octants & ~bits_of(failed_tests(lefts, 4.0f)); some; some &= some - 1) {{
        const unsigned octant = __builtin_ctz(some);
        const float fa = octant & 4 ? 4.0f : 0.0f, fb = octant & 2 ? 4.0f : 0.0f, fc = octant & 1 ? 4.0f : 0.0f;
        const T inner = FUSED(-fc, tz, FUSED(-fb, ty, FUSED(-fa, tx, tw)));
        float limits[8];
        __builtin_memcpy(limits, &inner, 32);
        M failed = failed_tests(limits, 2.0f);
        T least = {{}};
        #pragma unroll
        for (int axis = 0; axis < 3; ++axis) {{
            const int at = {EIGHTH} + 32 * axis + (octant >> (2 - axis) & 1) * 16;
            const float gap = number[{WITNESS} + 8 * axis + octant] - q.c[axis];
            const T low = gap * load(at), high = gap * load(at + 8);
            least += low < high ? low : high;
        }}
        failed |= least > number[{LIMIT} + octant] + more;
        const unsigned there = 255 & ~bits_of(failed);
        float* __restrict best = number + {MIN_VALUES} + 64 * octant;
        const int at_x = {VOXEL} + (octant << 2 & 16), at_y = {VOXEL + 32} + (octant << 3 & 16);
        const int at_z = {VOXEL + 64} + (octant << 4 & 16);
        if (kind == 0) {_measure(CORNER_TEXT)}
        else if (kind == 1 && near) {_measure(NEAR_EDGE_TEXT)}
        else if (kind == 1) {_measure(FAR_EDGE_TEXT)}
        else {_measure(FACE_TEXT)}
    }}
#endif
"""
)
def measure_octants(scratch: wp.uint64, kind: int, octants: int, room: float, near: bool, q: wp.vec3, radius2: float):
    """Lessen the values of voxels of the block's `octants` (bits) to those of the feature of this kind whose rows are
    the first, and which is within a ball around q.
    """
    ...


@wp.func
def ball_of(tree: Tree, slot: int, kind: int, part: int, centre: wp.vec3):
    """A point of a feature, from a block's centre, and the square of how far its corners are from there."""
    first, second, third, _normal = load_corners(tree, slot)
    if kind == CORNER_KIND:
        return one_of(part, first, second, third) - centre, 0.0
    if kind == EDGE_KIND:
        begin = one_of(part, first, second, third)
        end = one_of(part, second, third, first)
        return 0.5 * ((begin - centre) + (end - centre)), bulge_of_edge(end - begin)
    ab = second - first
    bc = third - second
    from_a = (2.0 * ab + bc) * (1.0 / 3.0)
    from_b = from_a - ab
    from_c = from_b - bc
    radius2 = wp.max(wp.dot(from_a, from_a), wp.max(wp.dot(from_b, from_b), wp.dot(from_c, from_c)))
    return (first - centre) + from_a, 1.000001 * radius2


@wp.func
def measure_list(
    tree: Tree,
    features: Features,
    pool: ChunkPool,
    blocks: CandidateLists,
    item: int,
    shares: int,
    scratch: wp.uint64,
    block: Block,
    octants: int,
    room: float,
):
    """Measure a block's `octants` (bits), on a grid along x, y and z, from the features of list `item`."""
    box = block.box
    begin_octants(scratch, -block.known.to_surface)
    reader = start_reading(blocks, item * shares, shares)
    upcoming = read_entry(pool, reader, 0)
    before = int(-1)
    while reader.left > 0:
        slot = upcoming >> 3
        reader = read_on(pool, blocks, reader, 1)
        upcoming = read_entry(pool, reader, 0)
        if slot != before:
            see_triangle(scratch, tree.corners, slot, box.centre)
        before = slot
    end_witnesses(scratch, box.half2, box.diagonal, box.half[0] + box.half[1] + box.half[2])
    reader = start_reading(blocks, item * shares, shares)
    upcoming = read_entry(pool, reader, 0)
    while reader.left > 0:
        feature = upcoming
        reader = read_on(pool, blocks, reader, 1)
        upcoming = read_entry(pool, reader, 0)
        which = feature & 7
        slot = feature >> 3
        part = which % 3
        kind = wp.where(which < 3, CORNER_KIND, wp.where(which < 6, EDGE_KIND, FACE_KIND))
        q, radius2 = ball_of(tree, slot, kind, part, box.centre)
        some = octants & octants_near(scratch, q, radius2)
        if some != 0:
            if kind == CORNER_KIND:
                add_corner(scratch, 0, tree, features, 4 * slot + part, box, block.floor)
            elif kind == EDGE_KIND:
                add_edge(scratch, 0, tree, features, 4 * slot + part, box, block.floor)
            else:
                add_face(scratch, 0, tree, features, 4 * slot, box, block.floor)
            measure_octants(scratch, kind, some, room, block.floor == 0.0, q, radius2)


@wp.func
def by_octants(winners: int):
    """True if values alone are wanted."""
    return True


@wp.func
def by_octants(winners: BlockOutput):  # noqa: F811
    return True


@wp.func
def by_octants(winners: wp.array(dtype=wp.int32)):  # noqa: F811
    return False
