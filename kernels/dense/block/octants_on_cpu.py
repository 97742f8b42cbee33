"""Measuring of a block's features on a CPU, one after the other, eight voxels at once.

As `octant_tests` and `min_values` have it, bit for bit, but without queues, which are for lanes that share work, and
without a branch between tests, as a CPU guesses wrong which of them fails; and with `octant_witnesses`.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, load_corners
from sdm.kernels.culling.voronoi_features import Features, one_of
from sdm.kernels.culling.witness_bound import bulge_of_edge
from sdm.kernels.dense.block.feature_setup import CORNER_KIND, EDGE_KIND, FACE_KIND, add_corner, add_edge, add_face
from sdm.kernels.dense.block.min_values import CORNER_TEXT, FACE_TEXT, FAR_EDGE_TEXT, NEAR_EDGE_TEXT
from sdm.kernels.dense.block.octant_witnesses import (
    AFRESH,
    EIGHTH,
    FARTHER,
    HALF,
    KEEP_REACH,
    LIMIT,
    LINE_REACH,
    MEASURED,
    MIDDLE,
    OCTANT_LINE_REACH,
    OCTANT_REACH,
    OCTANT_TYPES,
    REACH,
    VOXEL,
    WITNESS,
    begin_octants,
    end_witnesses,
    octants_near,
    see_triangle,
)
from sdm.kernels.dense.block.shared_layout import (
    BATCH,
    LATTICE_ROW,
    MIN_VALUES,
    TEST_ROW,
)
from sdm.kernels.dense.block.voxels import Block
from sdm.kernels.dense.block.winners import BlockOutput
from sdm.kernels.dense.chunk_pool import CandidateLists, ChunkPool, read_entry, read_on, start_reading
from sdm.kernels.primitives.fast_math import FUSED

wp.set_module_options({"enable_backward": False})


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


# Which of eight boxes are further from a face or an edge near the surface, by the rows that measure it, than their
# voxels are from the surface.
_IS_FARTHER = f"""
    auto is_farther = [&](const T* at, const T* half, T reach, T line) {{
        const Row r = row[0], e = row[{BATCH}];
        if (kind == {FACE_KIND}) {{
            const T height = at[0] * r.x + at[1] * r.y + at[2] * r.z + r.w;
            return size_of(height) > reach + half[0] * fabsf(r.x) + half[1] * fabsf(r.y) + half[2] * fabsf(r.z);
        }}
        const T along = at[0] * e.x + at[1] * e.y + at[2] * e.z;
        const T x = at[0] + r.x - along * e.x, y = at[1] + r.y - along * e.y, z = at[2] + r.z - along * e.z;
        return x * x + y * y + z * z > line;
    }};
"""


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {FUSED}
    {OCTANT_TYPES}
    typedef float Loose __attribute__((ext_vector_type(8), aligned(4)));
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
    const float farther = {FARTHER}f * wide;
    {_IS_FARTHER}
    {KEEP_REACH}
    M dropped = failed_tests(lefts, 4.0f);
    if (near && kind != {CORNER_KIND}) {{
        const T middle[3] = {{load({MIDDLE}), load({MIDDLE + 8}), load({MIDDLE + 16})}};
        const T half[3] = {{load({HALF}), load({HALF + 8}), load({HALF + 16})}};
        dropped |= is_farther(middle, half, load({OCTANT_REACH}), load({OCTANT_LINE_REACH}));
    }}
    for (unsigned some = octants & ~bits_of(dropped); some; some &= some - 1) {{
        const unsigned octant = __builtin_ctz(some);
        const float fa = octant & 4 ? 4.0f : 0.0f, fb = octant & 2 ? 4.0f : 0.0f, fc = octant & 1 ? 4.0f : 0.0f;
        const T inner = FUSED(-fc, tz, FUSED(-fb, ty, FUSED(-fa, tx, tw)));
        float limits[8];
        __builtin_memcpy(limits, &inner, 32);
        M failed = failed_tests(limits, 2.0f);
        T least = {{}}, middle[3], half[3];
        #pragma unroll
        for (int axis = 0; axis < 3; ++axis) {{
            const int at = {EIGHTH} + 32 * axis + (octant >> (2 - axis) & 1) * 16;
            const float gap = number[{WITNESS} + 8 * axis + octant] - q.c[axis];
            middle[axis] = load(at);
            half[axis] = load(at + 8);
            least += gap * middle[axis] - fabsf(gap) * half[axis];
        }}
        failed |= least > number[{LIMIT} + octant] + more;
        if (near && kind != {CORNER_KIND}) {{
            failed |= is_farther(middle, half, load({REACH} + 8 * octant), load({LINE_REACH} + 8 * octant));
        }}
        const unsigned there = 255 & ~bits_of(failed);
        if (there == 0) continue;
        float* __restrict best = number + {MIN_VALUES} + 64 * octant;
        const int at_x = {VOXEL} + (octant << 2 & 16), at_y = {VOXEL + 32} + (octant << 3 & 16);
        const int at_z = {VOXEL + 64} + (octant << 4 & 16);
        if (kind == 0) {_measure(CORNER_TEXT)}
        else if (kind == 1 && near) {_measure(NEAR_EDGE_TEXT)}
        else if (kind == 1) {_measure(FAR_EDGE_TEXT)}
        else {_measure(FACE_TEXT)}
        int measured;
        __builtin_memcpy(&measured, number + {MEASURED} + octant, 4);
        ++measured;
        __builtin_memcpy(number + {MEASURED} + octant, &measured, 4);
        if (near && measured % {AFRESH} == 0) {{
            T most;
            for (int in = 0; in < 8; ++in) most[in] = __builtin_reduce_max(*(const Loose*)(best + 8 * in));
            const T known = load({REACH} + 8 * octant), now = root(most) * {1.0 + FARTHER}f + farther;
            keep_reach(octant, now < known ? now : known);
        }}
    }}
#endif
"""
)
def measure_octants(
    scratch: wp.uint64, kind: int, octants: int, room: float, wide: float, near: bool, q: wp.vec3, radius2: float
):
    """Lessen the values of voxels of the block's `octants` (bits) to those of the feature of this kind whose rows are
    the first, and which is within a ball around q. The sum of the block's half-widths is `wide`.
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
    first: int,
    shares: int,
    scratch: wp.uint64,
    block: Block,
    octants: int,
    room: float,
):
    """Measure a block's `octants` (bits), on a grid along x, y and z, from the features of chains from `first` on."""
    box = block.box
    begin_octants(scratch, -block.known.to_surface)
    reader = start_reading(blocks, first, shares)
    upcoming = read_entry(pool, reader, 0)
    before = int(-1)
    while reader.left > 0:
        slot = upcoming >> 3
        reader = read_on(pool, blocks, reader, 1)
        upcoming = read_entry(pool, reader, 0)
        if slot != before:
            see_triangle(scratch, tree.corners, slot, box.centre)
        before = slot
    wide = box.half[0] + box.half[1] + box.half[2]
    end_witnesses(scratch, box.half2, box.diagonal, wide)
    reader = start_reading(blocks, first, shares)
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
            a, b, c, normal = load_corners(tree, slot)
            if kind == CORNER_KIND:
                add_corner(scratch, 0, a, b, c, features, 4 * slot + part, box, block.floor)
            elif kind == EDGE_KIND:
                add_edge(scratch, 0, a, b, c, normal, features, 4 * slot + part, box, block.floor)
            else:
                add_face(scratch, 0, a, b, c, normal, features, 4 * slot, box, block.floor)
            measure_octants(scratch, kind, some, room, wide, block.floor == 0.0, q, radius2)


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
