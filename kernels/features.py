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

A line counts where p is between its ends, a plane where p projects into the face, both with room for rounding: next to
them the neighbouring part is in the list too, if it can be nearest (see `parts`).
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.lanes import ballot, members, rank, write4
from sdm.kernels.parts import CORNER, EDGE, FACE, INVERSES, Parts
from sdm.kernels.tree import Tree, load_corners

wp.set_module_options({"enable_backward": False})

# Room of each list. One more batch of 32 triangles must fit before lists are measured and begun anew.
FACES, EDGES, CORNERS = 64, 192, 192
LANES_ROOM = wp.constant(32)
# Voxels of the largest block.
VOXELS = 512
# Rows of four floats: corner (-2m, w); edge (-2m, w) (e, place of its middle along it) (half its length, 0, 0, 0); face
# (n, 2h) and three planes (inward, height), then (w, 0, 0, 0).
CORNER_ROWS, EDGE_ROWS, FACE_ROWS = 1, 3, 5
ROWS = CORNERS * CORNER_ROWS + EDGES * EDGE_ROWS + FACES * FACE_ROWS

_FACES, _EDGES, _CORNERS = wp.constant(FACES), wp.constant(EDGES), wp.constant(CORNERS)
_ROWS = wp.constant(ROWS)
_EDGE_ROWS, _FACE_ROWS = wp.constant(EDGE_ROWS), wp.constant(FACE_ROWS)
_EDGE_ROW = wp.constant(CORNERS * CORNER_ROWS)
_FACE_ROW = wp.constant(CORNERS * CORNER_ROWS + EDGES * EDGE_ROWS)
_INVERSES = wp.constant(INVERSES)
# Room for rounding in "between the ends" and "inside the planes", in units of the sum of the block's half-widths.
NEAR_ENDS = wp.constant(2.0e-7)


@wp.struct
class Counts:
    """How many of each kind are in a block's lists."""

    corners: wp.int32
    edges: wp.int32
    faces: wp.int32


@wp.struct
class Features:
    """The lists of all workers, each in its own part, and what else they note."""

    rows: wp.array(dtype=wp.float32)  # (workers * ROWS * 4)
    least: wp.array(dtype=wp.float32)  # (workers * 512) the least values of a block's voxels so far
    points: wp.array(dtype=wp.float32)  # (workers * 3 * 512) x, y and z of a block's voxels from its centre (CPU)
    places: wp.array(dtype=wp.float32)  # (workers * 24) coordinates of a block's voxels along each axis


@wp.func
def are_full(counts: Counts):
    """Whether another batch of triangles might not fit."""
    return (
        counts.corners + 3 * LANES_ROOM > _CORNERS
        or counts.edges + 3 * LANES_ROOM > _EDGES
        or counts.faces + LANES_ROOM > _FACES
    )


@wp.func
def add_features(
    out: Features,
    worker: int,
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
    row = worker * _ROWS
    a = wp.vec3d(zero, zero, zero)
    b = a
    c = a
    normal = wp.vec3(0.0, 0.0, 0.0)
    if which != 0:
        middle = wp.vec3d(centre)
        corner_a, corner_b, corner_c, unit = load_corners(tree, slot)
        a = wp.vec3d(corner_a) - middle
        b = wp.vec3d(corner_b) - middle
        c = wp.vec3d(corner_c) - middle
        normal = unit

    face = (which & FACE) != 0
    mask = ballot(face)
    face_row = row + _FACE_ROW + _FACE_ROWS * (counts.faces + rank(mask, lane))
    if face:
        n = wp.cross(b - a, c - a)
        h = -wp.dot(n, a) * parts.inverses[_INVERSES * slot + 3]
        write4(out.rows, face_row, normal[0], normal[1], normal[2], 2.0 * float(h))
        write4(out.rows, face_row + 4, float(h * h - radius2), 0.0, 0.0, 0.0)
    counts.faces = counts.faces + members(mask)

    # The edges one after the other, turning the triangle.
    for k in range(3):
        edge = (which & (EDGE << k)) != 0
        corner = (which & (CORNER << k)) != 0
        mask = ballot(edge)
        if edge or face:
            inverse = parts.inverses[_INVERSES * slot + k]
            ab = b - a
            along = -wp.dot(a, ab) * inverse
            share = along * inverse
            m = a + share * ab
            e = wp.vec3(inverse * ab)
            if edge:
                to_row = row + _EDGE_ROW + _EDGE_ROWS * (counts.edges + rank(mask, lane))
                w = float(wp.dot(m, m) - radius2)
                half = wp.float64(0.5) * wp.length(ab)
                m2 = -2.0 * wp.vec3(m)
                write4(out.rows, to_row, m2[0], m2[1], m2[2], w)
                write4(out.rows, to_row + 1, e[0], e[1], e[2], float(half - along))
                write4(out.rows, to_row + 2, float(half), 0.0, 0.0, 0.0)
            if face:
                u = wp.cross(normal, e)
                write4(out.rows, face_row + 1 + k, u[0], u[1], u[2], -wp.dot(wp.vec3(m), u))
        counts.edges = counts.edges + members(mask)
        mask = ballot(corner)
        if corner:
            v = -2.0 * wp.vec3(a)
            write4(out.rows, row + counts.corners + rank(mask, lane), v[0], v[1], v[2], float(wp.dot(a, a) - radius2))
        counts.corners = counts.corners + members(mask)
        first = a
        a = b
        b = c
        c = first
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
        const Row* at = row + {CORNERS * CORNER_ROWS} + {EDGE_ROWS} * i;
        const Row r = at[0], e = at[1];
        const float half = at[2].x + room;
        for (int v = 0; v < count; ++v) {{
            const float along = x[v] * e.x + y[v] * e.y + z[v] * e.z;
            const float dx = x[v] + 0.5f * r.x - along * e.x, dy = y[v] + 0.5f * r.y - along * e.y;
            const float dz = z[v] + 0.5f * r.z - along * e.z;
            const float far = r.w + (x[v] * r.x + y[v] * r.y + z[v] * r.z) - along * along;
            const float d = NEAR ? dx * dx + dy * dy + dz * dz : far;
            const float here = fabsf(along - e.w) <= half ? d : INFINITY;
            best[v] = here < best[v] ? here : best[v];
        }}
    }}
    for (int i = 0; i < faces; ++i) {{
        const Row* at = row + {CORNERS * CORNER_ROWS + EDGES * EDGE_ROWS} + {FACE_ROWS} * i;
        const Row r = at[0], a = at[1], b = at[2], c = at[3];
        const float w = at[4].x, above_a = a.w + room, above_b = b.w + room, above_c = c.w + room;
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
    const Row* row = reinterpret_cast<const Row*>(rows.data) + (size_t)worker * {ROWS};
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
    rows: wp.array(dtype=wp.float32),
    worker: int,
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
    rows: wp.array(dtype=wp.float32),
    worker: int,
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
