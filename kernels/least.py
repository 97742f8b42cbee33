"""The least value of each voxel over the parts of its octant: see `features` for what a value is."""

from __future__ import annotations

import warp as wp

from sdm.kernels.rows import CORNER_BITS, EDGE_BITS, EDGE_ROW, ENDS, FACE_BITS, FACE_ROW, OFFSETS

wp.set_module_options({"enable_backward": False})

# Voxels of the largest block, and of an octant.
VOXELS, OCTANT = 512, 64


@wp.func
def is_near(radius2: float, half2: float):
    """Whether a block of squared half-diagonal `half2` is so near to the surface that plain distances tell more."""
    return radius2 < 16.0 * half2


def _each(count: str, bits: int, body: str) -> str:
    """C++ that runs `body` for each part i of `count` that matters to `octant`, the same for all lanes."""
    return f"""
#if defined(__CUDA_ARCH__)
    for (int base = 0; base < {count}; base += 32) {{
        const int mine = base + lane;
        unsigned left = __ballot_sync(0xffffffffu, mine < {count} && (whole[{bits} + mine] >> octant & 1));
        while (left) {{
            const int i = base + __ffs(left) - 1;
            left &= left - 1;
#else
    for (int i = 0; i < {count}; ++i) {{
        if (whole[{bits} + i] >> octant & 1) {{
#endif
            {body}
        }}
    }}
"""


# Measures `count` voxels (x, y and z from the block's centre) with those of a worker's rows that matter to their octant
# and keeps the lesser values in `best`. The same text for both devices, and for near and far blocks: a choice inside
# the loops would cost as much as a part.
_CORNERS = """
            const Row r = row[i];
            for (int v = 0; v < count; ++v) {
                const float dx = x[v] + 0.5f * r.x, dy = y[v] + 0.5f * r.y, dz = z[v] + 0.5f * r.z;
                const float d = NEAR ? dx * dx + dy * dy + dz * dz : r.w + (x[v] * r.x + y[v] * r.y + z[v] * r.z);
                best[v] = d < best[v] ? d : best[v];
            }
"""
_EDGES = f"""
            const Row* at = row + {EDGE_ROW} + 2 * i;
            const Row r = at[0], e = at[1];
            const float begin = e.w - room, end = number[{ENDS} + i] + room;
            for (int v = 0; v < count; ++v) {{
                const float along = x[v] * e.x + y[v] * e.y + z[v] * e.z;
                const float dx = x[v] + 0.5f * r.x - along * e.x, dy = y[v] + 0.5f * r.y - along * e.y;
                const float dz = z[v] + 0.5f * r.z - along * e.z;
                const float far = r.w + (x[v] * r.x + y[v] * r.y + z[v] * r.z) - along * along;
                const float d = NEAR ? dx * dx + dy * dy + dz * dz : far;
                const float here = ((along >= begin) & (along <= end)) ? d : INFINITY;
                best[v] = here < best[v] ? here : best[v];
            }}
"""
_FACES = f"""
            const Row* at = row + {FACE_ROW} + 4 * i;
            const Row r = at[0], a = at[1], b = at[2], c = at[3];
            const float w = number[{OFFSETS} + i], above_a = a.w - room, above_b = b.w - room, above_c = c.w - room;
            for (int v = 0; v < count; ++v) {{
                const float height = x[v] * r.x + y[v] * r.y + z[v] * r.z;
                const float plain = height + 0.5f * r.w;
                const float far = w + height * (r.w + height) - (x[v] * x[v] + y[v] * y[v] + z[v] * z[v]);
                const float d = NEAR ? plain * plain : far;
                const bool beside = (above_a + (x[v] * a.x + y[v] * a.y + z[v] * a.z) < 0.0f)
                    | (above_b + (x[v] * b.x + y[v] * b.y + z[v] * b.z) < 0.0f)
                    | (above_c + (x[v] * c.x + y[v] * c.y + z[v] * c.z) < 0.0f);
                const float here = beside ? INFINITY : d;
                best[v] = here < best[v] ? here : best[v];
            }}
"""
_MEASURE = (
    _each("corners", CORNER_BITS, _CORNERS) + _each("edges", EDGE_BITS, _EDGES) + _each("faces", FACE_BITS, _FACES)
)
_MEASURE_EITHER = f"""
    struct alignas(16) Row {{ float x, y, z, w; }};
    const Row* row = reinterpret_cast<const Row*>(rows);
    const float* number = reinterpret_cast<const float*>(rows);
    const int* whole = reinterpret_cast<const int*>(rows);
    if (near) {{ {_MEASURE.replace("NEAR", "true")} }}
    else {{ {_MEASURE.replace("NEAR", "false")} }}
"""


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    constexpr int count = 2;
    const float x[count] = {{p[0], q[0]}}, y[count] = {{p[1], q[1]}}, z[count] = {{p[2], q[2]}};
    float best[count] = {{least[0], least[1]}};
    {_MEASURE_EITHER}
    return wp::vec2(best[0], best[1]);
#else
    return least;
#endif
"""
)
def least_values(
    least: wp.vec2,
    rows: wp.uint64,
    corners: int,
    edges: int,
    faces: int,
    p: wp.vec3,
    q: wp.vec3,
    room: float,
    near: bool,
    octant: int,
    lane: int,
) -> wp.vec2:
    """On a GPU: `least`, or the lesser values of a worker's rows for two voxels p and q of an octant."""
    ...


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    const float* __restrict x = points.data + point;
    const float* __restrict y = x + {VOXELS};
    const float* __restrict z = y + {VOXELS};
    float* __restrict best = least.data + value;
    {_MEASURE_EITHER}
#endif
"""
)
def lessen_values(
    rows: wp.uint64,
    corners: int,
    edges: int,
    faces: int,
    points: wp.array(dtype=wp.float32),
    point: int,
    least: wp.array(dtype=wp.float32),
    value: int,
    count: int,
    room: float,
    near: bool,
    octant: int,
):
    """On a CPU: `least_values` for all voxels of an octant, in loops that a compiler turns into vectors.

    Voxel v is at points[point + v], + VOXELS and + 2 * VOXELS; its value is least[value + v].
    """
    ...


@wp.func
def least_distance(value: float, p: wp.vec3, radius2: float, near: bool):
    """The distance of voxel p (from the block's centre) that belongs to its least value."""
    if near:
        return wp.sqrt(value)
    # What is added to R^2 is small, and so is its rounding.
    return wp.sqrt(wp.max(radius2 + (value + wp.dot(p, p)), 0.0))
