"""Least value of each voxel over the features that matter to its eighth: see `feature_setup`.

Each lane measures one feature at the eight voxels of one eighth, which share most of the products. What it finds is
less than what was known only for a few, so these alone are written, by atomic minima: on a GPU of whole numbers, which
are in the order of the floats that they are read from, as none is negative by more than rounding.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.dense.block.shared_layout import BATCH, COORDINATES, LATTICE_ROW, MIN_VALUES, NUMBERS, write_row
from sdm.kernels.primitives.fast_math import FUSED

wp.set_module_options({"enable_backward": False})

# Voxels of the largest block.
VOXELS = 512

_MIN_VALUES_ROW = MIN_VALUES // 4
_ROWS = VOXELS // 4


# Texts that measure one feature: its rows, and what each voxel takes of them: a value, and whether it counts. A
# compiler sees what voxels of one eighth share. The same text for both devices, and near the surface and far away.
CORNER_TEXT = (
    "const Row r = row[feature];",
    """
            const float in_z = FUSED(FUSED(a, r.z, z), FUSED(b, r.z, z), r.w);
            const float in_yz = FUSED(FUSED(a, r.y, y), FUSED(b, r.y, y), in_z);
            const float d = FUSED(FUSED(a, r.x, x), FUSED(b, r.x, x), in_yz);
            const bool counts = true;
    """,
)
# Edges have two texts, as each is shorter than one for both, and they are measured most often.
_EDGE_ROWS = f"""
        const Row r = row[feature], e = row[{BATCH} + feature];
        const float begin = e.w - room, end = number[{NUMBERS} + feature] + room;
"""
NEAR_EDGE_TEXT = (
    _EDGE_ROWS,
    """
            const float along = FUSED(x, e.x, FUSED(y, e.y, z * e.z));
            const float dx = FUSED(-along, e.x, x + r.x), dy = FUSED(-along, e.y, y + r.y);
            const float dz = FUSED(-along, e.z, z + r.z), d = FUSED(dx, dx, FUSED(dy, dy, dz * dz));
            const bool counts = (along >= begin) & (along <= end);
    """,
)
FAR_EDGE_TEXT = (
    _EDGE_ROWS,
    """
            const float along = FUSED(x, e.x, FUSED(y, e.y, z * e.z));
            const float in_yz = FUSED(y, FUSED(2.0f, r.y, y), FUSED(z, FUSED(2.0f, r.z, z), r.w));
            const float d = FUSED(-along, along, FUSED(x, FUSED(2.0f, r.x, x), in_yz));
            const bool counts = (along >= begin) & (along <= end);
    """,
)
FACE_TEXT = (
    f"""
        const Row r = row[feature], i1 = row[{BATCH} + feature];
        const Row i2 = row[{2 * BATCH} + feature], i3 = row[{3 * BATCH} + feature];
        const float w = number[{NUMBERS} + feature], in_1 = room - i1.w, in_2 = room - i2.w, in_3 = room - i3.w;
    """,
    """
            const float height = FUSED(x, r.x, FUSED(y, r.y, z * r.z));
            const float d = FUSED(FUSED(a, r.w, height), FUSED(b, r.w, height), w);
            const float at_1 = FUSED(x, i1.x, FUSED(y, i1.y, z * i1.z));
            const float at_2 = FUSED(x, i2.x, FUSED(y, i2.y, z * i2.z));
            const float at_3 = FUSED(x, i3.x, FUSED(y, i3.y, z * i3.z));
            const bool counts = !((at_1 < in_1) | (at_2 < in_2) | (at_3 < in_3));
    """,
)


def _measure(feature: tuple[str, str], places: str, known: str, keep: tuple[str, str, str]) -> str:
    rows, own = feature
    on_gpu, after, on_cpu = keep
    return f"""
        {rows}
        // Two times four voxels, for a small instruction cache: bench/decisions/0001-kernel-code-size.md.
#if defined(__CUDA_ARCH__)
        #pragma unroll 1
#else
        #pragma unroll
#endif
        for (int side = 0; side < 2; ++side) {{
            {places}
#if defined(__CUDA_ARCH__)
            {known}
#endif
            #pragma unroll
            for (int v = 0; v < 4; ++v) {{
                const float x = xs[v], y = ys[v], z = zs[v];
                {own}
#if defined(__CUDA_ARCH__)
                const int value = __float_as_int(d);
                {on_gpu}
#else
                {on_cpu}
#endif
            }}
#if defined(__CUDA_ARCH__)
            {after}
#endif
        }}
"""


# Where the four voxels of one side of an eighth are: of most grids they share x, and each y and z with another.
_STRAIGHT = f"""
            const float x0 = number[{COORDINATES} + i + side];
            const float xs[4] = {{x0, x0, x0, x0}}, ys[4] = {{y0, y0, y1, y1}}, zs[4] = {{z0, z1, z0, z1}};
"""
_TURNED = """
            const float s = i + side;
            const float ox = o.x + FUSED(k, dk.x, FUSED(j, dj.x, s * di.x));
            const float oy = o.y + FUSED(k, dk.y, FUSED(j, dj.y, s * di.y));
            const float oz = o.z + FUSED(k, dk.z, FUSED(j, dj.z, s * di.z));
            const float xs[4] = {ox, ox + dk.x, ox + dj.x, ox + (dj.x + dk.x)};
            const float ys[4] = {oy, oy + dk.y, oy + dj.y, oy + (dj.y + dk.y)};
            const float zs[4] = {oz, oz + dk.z, oz + dj.z, oz + (dj.z + dk.z)};
"""


def _kinds(places: str, known: str, keep: tuple[str, str, str]) -> str:
    features = CORNER_TEXT, NEAR_EDGE_TEXT, FAR_EDGE_TEXT, FACE_TEXT
    corner, near, far, face = (_measure(feature, places, known, keep) for feature in features)
    edge = f"if (near) {{ {near} }} else {{ {far} }}"
    return f"if (kind == 0) {{ {corner} }} else if (kind == 1) {{ {edge} }} else {{ {face} }}"


def item_text(best: str, known: str, keep: tuple[str, str, str]) -> str:
    """Native text that measures an item, see `work_queues`.

    Args:
        best: Declares where the values of the eighth's voxels are.
        known: On a GPU, declares the least values `known` of four of them so far.
        keep: Keeps what is less of voxel v of these four: on a GPU, what it does after all four, and on a CPU.
    """
    return f"""
    {FUSED}
    struct alignas(16) Row {{ float x, y, z, w; }};
    const Row* row = reinterpret_cast<const Row*>(scratch);
    const float* number = reinterpret_cast<const float*>(scratch);
    const float a = near ? 1.0f : 0.0f, b = 2.0f - a;
    const unsigned feature = item & {BATCH - 1}, eighth = (unsigned)item / {BATCH};
    // The eighth's first voxel: its octant, and which one there.
    const unsigned octant = eighth & 7, in = eighth >> 3;
    const unsigned i = (octant & 4) + (in >> 1 & 2), j = (octant << 1 & 4) + (in & 2);
    const unsigned k = (octant << 2 & 4) + (in << 1 & 2);
    {best}
    if (turned) {{
        const Row o = row[{LATTICE_ROW}], di = row[{LATTICE_ROW + 1}], dj = row[{LATTICE_ROW + 2}];
        const Row dk = row[{LATTICE_ROW + 3}];
        {_kinds(_TURNED, known, keep)}
    }} else {{
        const float y0 = number[{COORDINATES + 8} + j], y1 = number[{COORDINATES + 9} + j];
        const float z0 = number[{COORDINATES + 16} + k], z1 = number[{COORDINATES + 17} + k];
        {_kinds(_STRAIGHT, known, keep)}
    }}
"""


_BEST = f"""
#if defined(__CUDA_ARCH__)
    int* best = reinterpret_cast<int*>(scratch) + {MIN_VALUES} + 64 * octant + 8 * in;
#else
    float* __restrict best = reinterpret_cast<float*>(scratch) + {MIN_VALUES} + 64 * octant + 8 * in;
#endif
"""
_KNOWN = """
            const int4 four = reinterpret_cast<const int4*>(best)[side];
            const int known[4] = {four.x, four.y, four.z, four.w};
"""
_KEEP = (
    "if (counts & (value < known[v])) atomicMin(best + 4 * side + v, value);",
    "",
    "best[4 * side + v] = (counts & (d < best[4 * side + v])) ? d : best[4 * side + v];",
)


@wp.func_native(snippet=item_text(_BEST, _KNOWN, _KEEP))
def measure_item(scratch: wp.uint64, item: int, kind: int, room: float, near: bool, turned: bool):
    """Lessen the values of an eighth's voxels to those of a feature, see `work_queues` for what an item is."""
    ...


@wp.func
def clear_values(scratch: wp.uint64, lane: int, lanes: int):
    """No voxel of the block has a value yet."""
    row = lane
    while row < _ROWS:
        write_row(scratch, _MIN_VALUES_ROW + row, float(wp.inf), float(wp.inf), float(wp.inf), float(wp.inf))
        row = row + lanes


@wp.func_native(
    snippet=f"""
    const float* at = reinterpret_cast<const float*>(scratch) + {MIN_VALUES} + 2 * number;
#if defined(__CUDA_ARCH__)
    const float2 two = *reinterpret_cast<const float2*>(at);
    return wp::vec2(two.x, two.y);
#else
    return wp::vec2(at[0], at[1]);
#endif
"""
)
def values_of(scratch: wp.uint64, number: int) -> wp.vec2:
    """The least values of the two voxels `number` of the block, see `two_at`; infinite where nothing was measured."""
    ...


@wp.func
def two_at(number: int):
    """The indices, from the block's first voxel, of the first of two voxels along z.

    Octant by octant, eighth by eighth, so that each bit of the number is one of an index.
    """
    return wp.vec3i(
        ((number >> 5) & 4) | ((number >> 3) & 2) | ((number >> 1) & 1),
        ((number >> 4) & 4) | ((number >> 2) & 2) | (number & 1),
        ((number >> 3) & 4) | ((number >> 1) & 2),
    )
