"""The least value of each voxel over the parts of its octant: see `features` for what a value is."""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from sdm.kernels.rows import CORNER_BITS, EDGE_BITS, EDGE_ROW, EDGES, ENDS, FACE_BITS, FACE_ROW, FACES, OFFSETS

wp.set_module_options({"enable_backward": False})

# Voxels of the largest block, and of an octant.
VOXELS, OCTANT = 512, 64


@wp.func
def is_near(radius2: float, half2: float):
    """Whether a block of squared half-diagonal `half2` is so near to the surface that plain distances tell more."""
    return radius2 < 16.0 * half2


def _each(count: str, bits: int, body: str) -> str:
    """C++ that runs `body` for each part i of `count` that matters to `octant`, the same for all lanes.

    On a GPU two at a time, so that one's rows are on their way while the other is measured; a last one alone is
    measured twice.
    """
    return f"""
#if defined(__CUDA_ARCH__)
    for (int base = 0; base < {count}; base += 32) {{
        const int mine = base + lane;
        unsigned left = __ballot_sync(0xffffffffu, mine < {count} && (whole[{bits} + mine] >> octant & 1));
        while (left) {{
            const int one = base + __ffs(left) - 1;
            left &= left - 1;
            const int two = left ? base + __ffs(left) - 1 : one;
            left &= left - 1;
            {{ const int i = one; {body} }}
            {{ const int i = two; {body} }}
        }}
    }}
#else
    for (int i = 0; i < {count}; ++i) {{
        if (whole[{bits} + i] >> octant & 1) {{
            {body}
        }}
    }}
#endif
"""


# What measures one part: its rows, what voxels with the same y and z share, and what each takes, with an x of its own.
# The same text for both devices, and for near and far blocks: a choice inside the loops would cost as much as a part.
_CORNER = (
    "const Row r = row[i];",
    """
                const float dy = y + 0.5f * r.y, dz = z + 0.5f * r.z;
                const float flat = NEAR ? dy * dy + dz * dz : r.w + (y * r.y + z * r.z);
    """,
    """
                const float dx = x + 0.5f * r.x;
                const float d = NEAR ? dx * dx + flat : x * r.x + flat;
                best[v] = lesser(d, best[v]);
    """,
)
_EDGE = (
    f"""
            const Row r = row[{EDGE_ROW} + i], e = row[{EDGE_ROW + EDGES} + i];
            const float begin = e.w - room, end = number[{ENDS} + i] + room;
    """,
    """
                const float dy = y + 0.5f * r.y, dz = z + 0.5f * r.z;
                const float middle = y * e.y + z * e.z, level = r.w + (y * r.y + z * r.z);
    """,
    """
                const float along = x * e.x + middle;
                const float ex = x + 0.5f * r.x - along * e.x, ey = dy - along * e.y, ez = dz - along * e.z;
                const float d = NEAR ? ex * ex + ey * ey + ez * ez : x * r.x + level - along * along;
                best[v] = ((along >= begin) & (along <= end)) ? lesser(d, best[v]) : best[v];
    """,
)
_FACE = (
    f"""
            const Row r = row[{FACE_ROW} + i], a = row[{FACE_ROW + FACES} + i];
            const Row b = row[{FACE_ROW + 2 * FACES} + i], c = row[{FACE_ROW + 3 * FACES} + i];
            const float w = number[{OFFSETS} + i], in_a = room - a.w, in_b = room - b.w, in_c = room - c.w;
    """,
    """
                const float level = y * r.y + z * r.z;
                const float flat_a = y * a.y + z * a.z, flat_b = y * b.y + z * b.z, flat_c = y * c.y + z * c.z;
    """,
    """
                const float height = x * r.x + level, plain = height + 0.5f * r.w;
                const float far = w + height * (r.w + height) - (x * x + y * y + z * z);
                const float d = NEAR ? plain * plain : far;
                const bool beside = (x * a.x + flat_a < in_a) | (x * b.x + flat_b < in_b) | (x * c.x + flat_c < in_c);
                best[v] = !beside ? lesser(d, best[v]) : best[v];
    """,
)


def _alone(part: tuple[str, str, str]) -> str:
    """C++ that measures `count` voxels, whatever their coordinates."""
    rows, shared, own = part
    return f"""
            {rows}
            for (int v = 0; v < count; ++v) {{
                const float x = xs[v], y = ys[v], z = zs[v];
                {shared} {own}
            }}
"""


def _together(part: tuple[str, str, str]) -> str:
    """The same where each voxel has the y and z of the one `apart` before it, and only its x is another.

    On a GPU these are a lane's voxels, on a CPU the four of an octant along x, for 16 at a time.
    """
    rows, shared, own = part
    return f"""
            {rows}
            for (int first = 0; first < apart; ++first) {{
                const float y = ys[first], z = zs[first];
                {shared}
                #pragma unroll
                for (int k = 0; k < count / apart; ++k) {{
                    const int v = first + k * apart;
                    const float x = xs[v];
                    {own}
                }}
            }}
"""


def _measure(form: Callable[[tuple[str, str, str]], str]) -> str:
    parts = (("corners", CORNER_BITS, _CORNER), ("edges", EDGE_BITS, _EDGE), ("faces", FACE_BITS, _FACE))
    text = "".join(_each(count, bits, form(part)) for count, bits, part in parts)
    return f"""
    if (near) {{ {text.replace("NEAR", "true")} }}
    else {{ {text.replace("NEAR", "false")} }}
"""


_ROWS = """
    struct alignas(16) Row { float x, y, z, w; };
    const Row* row = reinterpret_cast<const Row*>(rows);
    const float* number = reinterpret_cast<const float*>(rows);
    const unsigned char* whole = reinterpret_cast<const unsigned char*>(rows);
"""


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    {_ROWS}
    constexpr int count = 2, apart = 1;
    const float xs[count] = {{p[0], q[0]}}, ys[count] = {{p[1], q[1]}}, zs[count] = {{p[2], q[2]}};
    float best[count] = {{least[0], least[1]}};
    const auto lesser = [](float a, float b) {{ return fminf(a, b); }};
    if (turned) {{ {_measure(_alone)} }}
    else {{ {_measure(_together)} }}
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
    turned: bool,
    octant: int,
    lane: int,
) -> wp.vec2:
    """On a GPU: `least`, or the lesser values of a worker's rows for two voxels p and q of an octant.

    If the grid is not `turned` they have the same y and z.
    """
    ...


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    {_ROWS}
    const float* __restrict xs = points.data + point;
    const float* __restrict ys = xs + {VOXELS};
    const float* __restrict zs = ys + {VOXELS};
    float* __restrict best = least.data + value;
    constexpr int count = {OCTANT}, apart = 16;
    const auto lesser = [](float a, float b) {{ return a < b ? a : b; }};
    if (turned) {{ {_measure(_alone)} }}
    else {{ {_measure(_together)} }}
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
    room: float,
    near: bool,
    turned: bool,
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
