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

from sdm.kernels.lanes import ballot, members, rank, read4, write4
from sdm.kernels.parts import CORNER, EDGE, FACE, INVERSES, Parts
from sdm.kernels.tree import Tree, load_corners

wp.set_module_options({"enable_backward": False})

# Room of each list. One more batch of 32 triangles must fit before lists are measured and begun anew.
FACES, EDGES, CORNERS = 64, 192, 192
LANES_ROOM = wp.constant(32)
# Voxels of the largest block.
VOXELS = 512
# Rows of four floats: corner (-2m, w); edge (-2m, w) (e, from a) (to b, 0, 0, 0); face (n, 2h) and three planes
# (inward, height), then (w, 0, 0, 0).
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
    one = wp.float64(1.0)
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
                to_end = float((one - share) * wp.length(ab))
                m2 = -2.0 * wp.vec3(m)
                write4(out.rows, to_row, m2[0], m2[1], m2[2], w)
                write4(out.rows, to_row + 1, e[0], e[1], e[2], float(along))
                write4(out.rows, to_row + 2, to_end, 0.0, 0.0, 0.0)
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


@wp.func
def corner_value(r: wp.vec4, p: wp.vec3, near: bool):
    """What to compare for a corner: the squared distance of p, less |p|^2 + R^2 if that is not near."""
    if near:
        d = p + 0.5 * wp.vec3(r[0], r[1], r[2])
        return wp.dot(d, d)
    return r[3] + (p[0] * r[0] + p[1] * r[1] + p[2] * r[2])


@wp.func
def edge_value(r0: wp.vec4, r1: wp.vec4, to_end: float, p: wp.vec3, room: float, near: bool):
    """What to compare for an edge's line; infinity beyond its ends."""
    along = p[0] * r1[0] + p[1] * r1[1] + p[2] * r1[2]
    if wp.min(r1[3] + along, to_end - along) < -room:
        return float(wp.inf)
    if near:
        d = p + 0.5 * wp.vec3(r0[0], r0[1], r0[2]) - along * wp.vec3(r1[0], r1[1], r1[2])
        return wp.dot(d, d)
    return r0[3] + (p[0] * r0[0] + p[1] * r0[1] + p[2] * r0[2]) - along * along


@wp.func
def above(r: wp.vec4, p: wp.vec3):
    return r[3] + (p[0] * r[0] + p[1] * r[1] + p[2] * r[2])


@wp.func
def face_value(r0: wp.vec4, r1: wp.vec4, r2: wp.vec4, r3: wp.vec4, w: float, p: wp.vec3, room: float, near: bool):
    """What to compare for a face's plane; infinity beside the face."""
    if wp.min(above(r1, p), wp.min(above(r2, p), above(r3, p))) < -room:
        return float(wp.inf)
    height = p[0] * r0[0] + p[1] * r0[1] + p[2] * r0[2]
    if near:
        height = height + 0.5 * r0[3]
        return height * height
    return w + height * (r0[3] + height) - wp.dot(p, p)


@wp.func
def least_values(
    least: wp.vec2, features: Features, worker: int, counts: Counts, p: wp.vec3, q: wp.vec3, room: float, near: bool
):
    """`least`, or the lesser values of a worker's lists for the voxels p and q (from the block's centre)."""
    row = worker * _ROWS
    of_p = least[0]
    of_q = least[1]
    for i in range(counts.corners):
        r0 = read4(features.rows, row + i)
        of_p = wp.min(of_p, corner_value(r0, p, near))
        of_q = wp.min(of_q, corner_value(r0, q, near))
    for i in range(counts.edges):
        at = row + _EDGE_ROW + _EDGE_ROWS * i
        r0 = read4(features.rows, at)
        r1 = read4(features.rows, at + 1)
        to_end = features.rows[4 * (at + 2)]
        of_p = wp.min(of_p, edge_value(r0, r1, to_end, p, room, near))
        of_q = wp.min(of_q, edge_value(r0, r1, to_end, q, room, near))
    for i in range(counts.faces):
        at = row + _FACE_ROW + _FACE_ROWS * i
        r0 = read4(features.rows, at)
        r1 = read4(features.rows, at + 1)
        r2 = read4(features.rows, at + 2)
        r3 = read4(features.rows, at + 3)
        w = features.rows[4 * (at + 4)]
        of_p = wp.min(of_p, face_value(r0, r1, r2, r3, w, p, room, near))
        of_q = wp.min(of_q, face_value(r0, r1, r2, r3, w, q, room, near))
    return wp.vec2(of_p, of_q)


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    const float* row = rows.data + 4 * (size_t)worker * {ROWS};
    const float* __restrict x = points.data + point;
    const float* __restrict y = x + {VOXELS};
    const float* __restrict z = y + {VOXELS};
    float* __restrict best = least.data + value;
    for (int i = 0; i < corners; ++i) {{
        const float* r = row + 4 * i;
        const float mx = r[0], my = r[1], mz = r[2], w = r[3];
        if (near)
            for (int v = 0; v < total; ++v) {{
                float dx = x[v] + 0.5f * mx, dy = y[v] + 0.5f * my, dz = z[v] + 0.5f * mz;
                float d = dx * dx + dy * dy + dz * dz;
                best[v] = d < best[v] ? d : best[v];
            }}
        else
            for (int v = 0; v < total; ++v) {{
                float d = w + (x[v] * mx + y[v] * my + z[v] * mz);
                best[v] = d < best[v] ? d : best[v];
            }}
    }}
    row += 4 * {CORNERS * CORNER_ROWS};
    for (int i = 0; i < edges; ++i) {{
        const float* r = row + 4 * {EDGE_ROWS} * i;
        const float mx = r[0], my = r[1], mz = r[2], w = r[3];
        const float ex = r[4], ey = r[5], ez = r[6], from = r[7] + room, to = r[8] + room;
        if (near)
            for (int v = 0; v < total; ++v) {{
                float along = x[v] * ex + y[v] * ey + z[v] * ez;
                float dx = x[v] + 0.5f * mx - along * ex, dy = y[v] + 0.5f * my - along * ey;
                float dz = z[v] + 0.5f * mz - along * ez;
                float d = dx * dx + dy * dy + dz * dz;
                bool beside = (from + along < 0.0f) | (to - along < 0.0f);
                d = beside ? INFINITY : d;
                best[v] = d < best[v] ? d : best[v];
            }}
        else
            for (int v = 0; v < total; ++v) {{
                float along = x[v] * ex + y[v] * ey + z[v] * ez;
                float d = w + (x[v] * mx + y[v] * my + z[v] * mz) - along * along;
                bool beside = (from + along < 0.0f) | (to - along < 0.0f);
                d = beside ? INFINITY : d;
                best[v] = d < best[v] ? d : best[v];
            }}
    }}
    row += 4 * {EDGES * EDGE_ROWS};
    for (int i = 0; i < faces; ++i) {{
        const float* r = row + 4 * {FACE_ROWS} * i;
        const float nx = r[0], ny = r[1], nz = r[2], h2 = r[3], w = r[16];
        const float ax = r[4], ay = r[5], az = r[6], a = r[7] + room;
        const float bx = r[8], by = r[9], bz = r[10], b = r[11] + room;
        const float cx = r[12], cy = r[13], cz = r[14], c = r[15] + room;
        for (int v = 0; v < total; ++v) {{
            float height = x[v] * nx + y[v] * ny + z[v] * nz;
            float far = w + height * (h2 + height) - (x[v] * x[v] + y[v] * y[v] + z[v] * z[v]);
            float plain = (height + 0.5f * h2) * (height + 0.5f * h2);
            float d = near ? plain : far;
            bool beside = (a + (x[v] * ax + y[v] * ay + z[v] * az) < 0.0f)
                | (b + (x[v] * bx + y[v] * by + z[v] * bz) < 0.0f)
                | (c + (x[v] * cx + y[v] * cy + z[v] * cz) < 0.0f);
            d = beside ? INFINITY : d;
            best[v] = d < best[v] ? d : best[v];
        }}
    }}
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
    total: int,
    room: float,
    near: bool,
):
    """`least_values` on a CPU, for all voxels of a block: loops over voxels that a compiler turns into vectors.

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
