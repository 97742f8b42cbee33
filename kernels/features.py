"""The parts of triangles that can be nearest to a block's voxels, written so that measuring one takes a few products.

Let c be the block's centre, p a voxel from there, R the distance of c from the surface, and m the point of a part's
plane, line or corner that is closest to c, seen from c. With w = |m|^2 - R^2, the squared distances less R^2 + |p|^2
are

    corner  w - 2 p.m
    line    w - 2 p.m - (p.e)^2                along the unit vector e
    plane   w + (p.n) (2 h + p.n) - |p|^2      at height h = -m.n above it

Only w comes from long distances, and it is found in float64 and is small, as all parts that are left are nearly
equally far from c; the rest is of the block's size. So float32 is more accurate here than it could be with the squared
distances themselves, of which the least is made only at the end. Near the surface it is the other way round: there the
distances are smaller than the brick, and are taken from p - m, its part across the line, or the height.

A line counts where p is between its ends, with room for rounding: next to them the corner is in the list too, if it can
be nearest (see `parts`). A plane counts where p projects into the face by more than rounding: next to its edges those
are in the list, and nearly as near. With room instead, a needle would reach far beyond its tip.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.lanes import ballot, members, rank
from sdm.kernels.parts import CORNER, EDGE, FACE, INVERSES, Parts
from sdm.kernels.tree import Tree, load_corners

wp.set_module_options({"enable_backward": False})

# Room of each list. A batch of 32 triangles, each with all its parts, must fit into empty ones.
FACES, EDGES, CORNERS = 76, 128, 128
# Voxels of the largest block.
VOXELS = 512
# A worker's rows of four floats: corners (-2m, w); edges (-2m, w) (e, where it begins along it); faces (n, 2h) and
# three planes (inward, height); then single numbers: where each edge ends, w of each face, and 24 coordinates
# of the block's voxels. On a GPU they are in shared memory, whose latency is a tenth of what it is to memory.
EDGE_ROW = CORNERS
FACE_ROW = EDGE_ROW + 2 * EDGES
ENDS = 4 * (FACE_ROW + 4 * FACES)
OFFSETS = ENDS + EDGES
PLACES = OFFSETS + FACES
ROWS = (PLACES + 24) // 4
# Blocks of threads have four groups of lanes.
_GROUPS = 4

_FACES, _EDGES, _CORNERS = wp.constant(FACES), wp.constant(EDGES), wp.constant(CORNERS)
_EDGE_ROW, _FACE_ROW = wp.constant(EDGE_ROW), wp.constant(FACE_ROW)
_ENDS, _OFFSETS, _PLACES = wp.constant(ENDS), wp.constant(OFFSETS), wp.constant(PLACES)
_INVERSES = wp.constant(INVERSES)
# Room for rounding in "between the ends" and "inside the planes", in units of the sum of the block's half-widths.
NEAR_ENDS = wp.constant(2.0e-7)
# And what rounding can add to a height inside a plane, in units of the distance from its edge.
WITHIN = wp.constant(4.0e-7)


@wp.struct
class Counts:
    """How many of each kind are in a block's lists."""

    corners: wp.int32
    edges: wp.int32
    faces: wp.int32


@wp.struct
class Features:
    """What all workers note, each in its own part; the rows are in shared memory on a GPU."""

    rows: wp.array(dtype=wp.float32)  # (workers * ROWS * 4) on a CPU
    points: wp.array(dtype=wp.float32)  # (workers * 3 * 512) x, y and z of a block's voxels from its centre, on a CPU
    least: wp.array(dtype=wp.float32)  # (workers * 512) the least values of a block's voxels so far


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    __shared__ float4 shared[{_GROUPS} * {ROWS}];
    return (wp::uint64)(shared + threadIdx.x / 32 * {ROWS});
#else
    return (wp::uint64)(rows.data + 4 * (size_t)worker * {ROWS});
#endif
"""
)
def rows_of(rows: wp.array(dtype=wp.float32), worker: int) -> wp.uint64:
    """The address of a worker's rows."""
    ...


@wp.func_native(
    snippet="""
    struct alignas(16) Row { float x, y, z, w; };
    reinterpret_cast<Row*>(rows)[index] = Row{x, y, z, w};
"""
)
def write_row(rows: wp.uint64, index: int, x: float, y: float, z: float, w: float): ...


@wp.func_native(snippet="reinterpret_cast<float*>(rows)[index] = value;")
def write_number(rows: wp.uint64, index: int, value: float): ...


@wp.func_native(snippet="return reinterpret_cast<const float*>(rows)[index];")
def read_number(rows: wp.uint64, index: int) -> float: ...


@wp.func
def write_place(rows: wp.uint64, index: int, value: float):
    """Note one of the 24 coordinates of the block's voxels: 8 along each axis."""
    write_number(rows, _PLACES + index, value)


@wp.func
def read_place(rows: wp.uint64, index: int):
    return read_number(rows, _PLACES + index)


@wp.func
def has_room(counts: Counts, which: int):
    """Whether the parts of the lanes' triangles (bits, see `parts`) fit into the lists."""
    corners = counts.corners
    edges = counts.edges
    for k in range(3):
        corners = corners + members(ballot((which & (CORNER << k)) != 0))
        edges = edges + members(ballot((which & (EDGE << k)) != 0))
    return corners <= _CORNERS and edges <= _EDGES and counts.faces + members(ballot((which & FACE) != 0)) <= _FACES


@wp.func
def add_features(
    rows: wp.uint64,
    counts: Counts,
    tree: Tree,
    parts: Parts,
    slot: int,
    which: int,
    centre: wp.vec3,
    radius: float,
    lane: int,
):
    """Each lane adds the parts `which` (bits, see `parts`) of the triangle in its slot; returns the new counts."""
    zero = wp.float64(0.0)
    radius2 = wp.float64(radius)
    a = wp.vec3d(zero, zero, zero)
    b = a
    c = a
    ab = a
    bc = a
    ca = a
    normal = wp.vec3(0.0, 0.0, 0.0)
    inverses = wp.vec4d(zero, zero, zero, zero)
    if which != 0:
        middle = wp.vec3d(centre)
        corner_a, corner_b, corner_c, unit = load_corners(tree, slot)
        a = wp.vec3d(corner_a) - middle
        b = wp.vec3d(corner_b) - middle
        c = wp.vec3d(corner_c) - middle
        # Not b - a, which would be zero for a triangle that is very small for its distance.
        ab = wp.vec3d(corner_b) - wp.vec3d(corner_a)
        bc = wp.vec3d(corner_c) - wp.vec3d(corner_b)
        ca = wp.vec3d(corner_a) - wp.vec3d(corner_c)
        normal = unit
        # All at once: loads one after the other wait for each other.
        for k in range(4):
            inverses[k] = parts.inverses[_INVERSES * slot + k]

    face = (which & FACE) != 0
    mask = ballot(face)
    number = counts.faces + rank(mask, lane)
    face_row = _FACE_ROW + 4 * number
    if face:
        n = wp.cross(ab, -ca)
        h = -wp.dot(n, a) * inverses[3]
        write_row(rows, face_row, normal[0], normal[1], normal[2], 2.0 * float(h))
        write_number(rows, _OFFSETS + number, float(h * h - radius2))
    counts.faces = counts.faces + members(mask)

    # The edges one after the other, turning the triangle.
    for k in range(3):
        edge = (which & (EDGE << k)) != 0
        corner = (which & (CORNER << k)) != 0
        mask = ballot(edge)
        if edge or face:
            inverse = inverses[k]
            along = -wp.dot(a, ab) * inverse
            share = along * inverse
            m = a + share * ab
            e = wp.vec3(inverse * ab)
            if edge:
                number = counts.edges + rank(mask, lane)
                to_row = _EDGE_ROW + 2 * number
                w = float(wp.dot(m, m) - radius2)
                m2 = -2.0 * wp.vec3(m)
                write_row(rows, to_row, m2[0], m2[1], m2[2], w)
                write_row(rows, to_row + 1, e[0], e[1], e[2], float(-along))
                write_number(rows, _ENDS + number, float(wp.length(ab) - along))
            if face:
                u = wp.cross(normal, e)
                away = wp.vec3(m)
                within = -wp.dot(away, u) - WITHIN * wp.length(away)
                write_row(rows, face_row + 1 + k, u[0], u[1], u[2], within)
        counts.edges = counts.edges + members(mask)
        mask = ballot(corner)
        if corner:
            v = -2.0 * wp.vec3(a)
            write_row(rows, counts.corners + rank(mask, lane), v[0], v[1], v[2], float(wp.dot(a, a) - radius2))
        counts.corners = counts.corners + members(mask)
        first = a
        a = b
        b = c
        c = first
        first = ab
        ab = bc
        bc = ca
        ca = first
    return counts


@wp.func
def is_near(radius2: float, half2: float):
    """Whether a block of squared half-diagonal `half2` is so near to the surface that plain distances tell more."""
    return radius2 < 16.0 * half2


# Measures `count` voxels (x, y and z from the block's centre) with all rows of a worker and keeps the lesser values in
# `best`. The same text for both devices, and for near and far blocks: a choice inside the loops would cost as much as a
# feature.
_MEASURE = f"""
    for (int i = 0; i < corners; ++i) {{
        const Row r = row[i];
        for (int v = 0; v < count; ++v) {{
            const float dx = x[v] + 0.5f * r.x, dy = y[v] + 0.5f * r.y, dz = z[v] + 0.5f * r.z;
            const float d = NEAR ? dx * dx + dy * dy + dz * dz : r.w + (x[v] * r.x + y[v] * r.y + z[v] * r.z);
            best[v] = d < best[v] ? d : best[v];
        }}
    }}
    for (int i = 0; i < edges; ++i) {{
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
    }}
    for (int i = 0; i < faces; ++i) {{
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
    }}
"""
_MEASURE_EITHER = f"""
    struct alignas(16) Row {{ float x, y, z, w; }};
    const Row* row = reinterpret_cast<const Row*>(rows);
    const float* number = reinterpret_cast<const float*>(rows);
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
) -> wp.vec2:
    """On a GPU: `least`, or the lesser values of a worker's rows for the voxels p and q (from the block's centre)."""
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
):
    """On a CPU: `least_values` for all voxels of a block, in loops that a compiler turns into vectors.

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
