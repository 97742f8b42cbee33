"""Voronoi features: the face, edges and corners of a triangle that can be nearest to some voxel of a box.

Let x be the point of the surface that is nearest to p. Then x lies inside a face, inside an edge, or on a corner, and
no way along the surface leads closer:

- x inside a face: p projects into it, so p is on the inner side of the three planes that stand on its edges;
- x inside an edge: p lies between the two planes across the edge's ends, and (p - x).u <= 0 for the direction u that
  leads from the edge into any triangle at it, at right angles to the edge;
- x on a corner: (p - x).e <= 0 for the direction e of any edge that begins there.

Each is a linear inequality that must hold; where one fails for all points of a box, the feature is dropped for that
box. Any subset of the inequalities will do, so a mesh may have holes, flipped faces and edges of many triangles: two
triangles at an edge, and four or five edges at a corner, are looked at. Those of a corner are next to each other; of
six that are spread evenly the first four leave half a plane behind them, and only with the fifth a line. A triangle
without a normal gives no inequality.

Triangles share edges and corners, but only one of them, the owner, lists each. That loses nothing: if x lies on a
shared feature then all its triangles are equally near, and no test here or in `witness_bound` drops a triangle that is
nearest.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import (
    BY_FACES,
    FRAME_SIZE,
    SCALE,
    Tree,
    load_corners,
    mesh_of_slot,
    rows_before,
    slots_of,
    tree_of,
)
from sdm.kernels.culling.witness_bound import (
    Witness,
    bulge_of_edge,
    bulge_of_triangle,
    doubt,
    least_lead,
    reach,
    sum_abs,
)
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.launch import launch
from sdm.kernels.primitives.coalesced_stores import begin_record, doubles_at, end_record, floats_at, put4, put_double
from sdm.kernels.primitives.fast_math import about_inverse_root, about_root, inverse_root
from sdm.kernels.primitives.vector_loads import load4, load_row, write4

wp.set_module_options({"enable_backward": False})

# Per triangle six rows of four floats: of each edge ab, bc and ca the neighbour's unit vector inwards, and the owned
# features, `first`, 0; then of each the neighbour's far corner, and x, y, z of the end of one more edge from the first
# corner that the triangle owns and that has one, which is `first`, or -1.
FEATURE_ROWS = 6
FEATURE_FLOATS = 4 * FEATURE_ROWS
_ROWS, _FLOATS = FEATURE_ROWS, FEATURE_FLOATS
# Per triangle, in float64: 1/|ab|, 1/|bc|, 1/|ca|, 1/|ab x ac|; zero where there is no such direction.
INVERSES = 4

# Bits of the features: as these are numbered, see `leaves`.
CORNER, EDGE, FACE = 1, 8, 64
# Relative room for rounding in the inequalities, about 16 float32 roundings of the triangle's distance and the box.
ROOM = 2.0e-6

# Squares of lengths below this one may vanish, but not if the lengths are so many times as large.
SMALL_SQUARE, ENLARGED = 2.0**-100, 2.0**66


@wp.struct
class Features:
    """Features of the triangles and of their neighbours."""

    rows: wp.array(dtype=wp.float32)  # (slots * FEATURE_FLOATS)
    inverses: wp.array(dtype=wp.float64)  # (slots * INVERSES)
    balls: wp.array(dtype=wp.float32)  # (slots * 4) a ball around each triangle: its centre and its radius


@wp.func_native(
    snippet="""
    return wp::vec3(i == 0 ? a[0] : i == 1 ? b[0] : c[0], i == 0 ? a[1] : i == 1 ? b[1] : c[1],
                    i == 0 ? a[2] : i == 1 ? b[2] : c[2]);
"""
)
def one_of(i: int, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """The vector of number i."""
    ...


@wp.func
def may_be_below(half: wp.vec3, q: wp.vec3, u: wp.vec3, room: float):
    """True if (p - x).u <= 0 for some p of a box, x being at q from its centre."""
    return -wp.dot(q, u) - reach(half, u) <= room * sum_abs(u)


@wp.func
def load_feature_row(features: Features, slot: int, row: int):
    """A row of the triangle in a slot."""
    return load4(features.rows, _ROWS * slot + row)


@wp.func
def last_of_row(features: Features, slot: int, row: int):
    """The last of a row's four floats."""
    return features.rows[4 * (_ROWS * slot + row) + 3]


@wp.func
def further_end(features: Features, slot: int):
    """The end of the one more edge, if a triangle has it."""
    return wp.vec3(last_of_row(features, slot, 3), last_of_row(features, slot, 4), last_of_row(features, slot, 5))


@wp.func
def features_that_matter(box: VoxelBox, known: Witness, tree: Tree, features: Features, slot: int):
    """The owned features of a triangle that can be nearest to some voxel of the box, as bits."""
    corner_a, corner_b, corner_c, normal = load_corners(tree, slot)
    in_ab = load_feature_row(features, slot, 0)
    in_bc = load_feature_row(features, slot, 1)
    in_ca = load_feature_row(features, slot, 2)
    over_ab = load_feature_row(features, slot, 3)
    over_bc = load_feature_row(features, slot, 4)
    over_ca = load_feature_row(features, slot, 5)
    a = corner_a - box.centre
    b = corner_b - box.centre
    c = corner_c - box.centre
    beyond_ab = wp.vec3(over_ab[0], over_ab[1], over_ab[2])
    beyond_bc = wp.vec3(over_bc[0], over_bc[1], over_bc[2])
    beyond_ca = wp.vec3(over_ca[0], over_ca[1], over_ca[2])
    owned = int(in_ab[3])
    half = box.half
    far = wp.max(sum_abs(a), wp.max(sum_abs(b), sum_abs(c)))
    room = ROOM * (far + half[0] + half[1] + half[2])
    # Not b - a, which rounding from afar has turned.
    ab = corner_b - corner_a
    bc = corner_c - corner_b
    ca = corner_a - corner_c
    result = int(0)

    # Which of the corners, edges and the face the witness leaves, see `witness_bound`.
    lead_a = least_lead(box, known, a)
    lead_b = least_lead(box, known, b)
    lead_c = least_lead(box, known, c)
    most = doubt(box, known)
    left = int(0)
    if wp.min(lead_a, wp.min(lead_b, lead_c)) <= most + bulge_of_triangle(ab, bc, ca):
        left = FACE
    if wp.min(lead_a, lead_b) <= most + bulge_of_edge(ab):
        left = left | EDGE
    if wp.min(lead_b, lead_c) <= most + bulge_of_edge(bc):
        left = left | (2 * EDGE)
    if wp.min(lead_c, lead_a) <= most + bulge_of_edge(ca):
        left = left | (4 * EDGE)
    if lead_a <= most:
        left = left | CORNER
    if lead_b <= most:
        left = left | (2 * CORNER)
    if lead_c <= most:
        left = left | (4 * CORNER)
    owned = (owned | FACE) & left

    # Heights above the three planes on the edges, at the box's centre and how they vary.
    u = wp.cross(normal, ab)
    height_ab = -wp.dot(a, u)
    reach_ab = reach(half, u) + room * sum_abs(u)
    u = wp.cross(normal, bc)
    height_bc = -wp.dot(b, u)
    reach_bc = reach(half, u) + room * sum_abs(u)
    u = wp.cross(normal, ca)
    height_ca = -wp.dot(c, u)
    reach_ca = reach(half, u) + room * sum_abs(u)
    if height_ab + reach_ab >= 0.0 and height_bc + reach_bc >= 0.0 and height_ca + reach_ca >= 0.0:
        if wp.dot(normal, normal) > 0.5:
            result = owned & FACE

    # Each edge: outside of the face, outside of the neighbour, between the ends.
    along_ab = -wp.dot(a, ab)
    length_ab = wp.dot(ab, ab)
    spread_ab = reach(half, ab) + room * sum_abs(ab)
    along_bc = -wp.dot(b, bc)
    length_bc = wp.dot(bc, bc)
    spread_bc = reach(half, bc) + room * sum_abs(bc)
    along_ca = -wp.dot(c, ca)
    length_ca = wp.dot(ca, ca)
    spread_ca = reach(half, ca) + room * sum_abs(ca)
    if (owned & EDGE) != 0 and height_ab - reach_ab <= 0.0 and sum_abs(ab) > 0.0:
        if along_ab + spread_ab >= 0.0 and along_ab - spread_ab <= length_ab:
            if may_be_below(half, a, wp.vec3(in_ab[0], in_ab[1], in_ab[2]), room):
                result = result | EDGE
    if (owned & (2 * EDGE)) != 0 and height_bc - reach_bc <= 0.0 and sum_abs(bc) > 0.0:
        if along_bc + spread_bc >= 0.0 and along_bc - spread_bc <= length_bc:
            if may_be_below(half, b, wp.vec3(in_bc[0], in_bc[1], in_bc[2]), room):
                result = result | (2 * EDGE)
    if (owned & (4 * EDGE)) != 0 and height_ca - reach_ca <= 0.0 and sum_abs(ca) > 0.0:
        if along_ca + spread_ca >= 0.0 and along_ca - spread_ca <= length_ca:
            if may_be_below(half, c, wp.vec3(in_ca[0], in_ca[1], in_ca[2]), room):
                result = result | (4 * EDGE)

    # Each corner: behind its two edges, and behind the neighbours' edges there.
    if (owned & CORNER) != 0 and along_ab - spread_ab <= 0.0 and along_ca + spread_ca >= length_ca:
        if may_be_below(half, a, beyond_ab - corner_a, room) and may_be_below(half, a, beyond_ca - corner_a, room):
            result = result | CORNER
    if (owned & (2 * CORNER)) != 0 and along_bc - spread_bc <= 0.0 and along_ab + spread_ab >= length_ab:
        if may_be_below(half, b, beyond_bc - corner_b, room) and may_be_below(half, b, beyond_ab - corner_b, room):
            result = result | (2 * CORNER)
    if (owned & (4 * CORNER)) != 0 and along_ca - spread_ca <= 0.0 and along_bc + spread_bc >= length_bc:
        if may_be_below(half, c, beyond_ca - corner_c, room) and may_be_below(half, c, beyond_bc - corner_c, room):
            result = result | (4 * CORNER)
    if (result & (7 * CORNER)) != 0:
        # And one more edge from the first of them. This is read now as there are too few registers for all at once.
        k = int(last_of_row(features, slot, 1))
        if k >= 0:
            further = further_end(features, slot) - one_of(k, corner_a, corner_b, corner_c)
            if not may_be_below(half, one_of(k, a, b, c), further, room):
                result = result & ~(CORNER << k)
    return result


@wp.func
def inverse_length(v: wp.vec3d):
    square = wp.dot(v, v)
    if square > wp.float64(0.0):
        return inverse_root(square)
    return wp.float64(0.0)


@wp.func
def across_edge(
    vertices: wp.array2d(dtype=wp.vec3),
    normals: wp.array(dtype=wp.float32),
    faces: wp.array2d(dtype=wp.int32),
    mesh: int,
    base: int,
    scale: float,
    begin: wp.vec3,
    end: wp.vec3,
    last: int,
    other: int,
    beyond: wp.vec3,
):
    """The unit vector from an edge into its neighbour `other` (3 * face + edge), and the neighbour's far corner.

    The edge ends at the vertex `last`, and the mesh's normals begin `base` after where its faces do. Without a
    neighbour no direction, and `beyond`: the triangle's own far corner, which says nothing new.
    """
    inward = wp.vec3(0.0, 0.0, 0.0)
    if other >= 0:
        side = other % 3
        there = other / 3
        # All loads before their use.
        first = faces[there, side]
        beyond = scale * vertices[mesh, faces[there, (side + 2) % 3]]
        normal = load4(normals, base + there)
        # Most neighbours go along the edge the other way.
        along = wp.where(first == last, begin - end, end - begin)
        across = wp.cross(wp.vec3(normal[0], normal[1], normal[2]), along)
        square = wp.length_sq(across)
        if square < SMALL_SQUARE:
            across = ENLARGED * across
            square = wp.length_sq(across)
        if square > 0.0:
            inward = about_inverse_root(square) * across
    return inward, beyond


@wp.func
def end_of_further_edge(
    faces: wp.array2d(dtype=wp.int32), neighbours: wp.array2d(dtype=wp.int32), vertex: int, other: int
):
    """The end of the edge from a vertex that is next to those of `other`, a triangle there; -1 if there is none.

    `other` is given by the edge over which it was come to, as 3 * face + edge.
    """
    if other < 0:
        return -1
    there = other / 3
    side = other % 3
    # The other edge from the vertex, which is at either end of the one that was crossed.
    leave = (side + 2) % 3
    if faces[there, (side + 1) % 3] == vertex:
        leave = (side + 1) % 3
    elif faces[there, side] != vertex:
        return -1
    following = neighbours[there, leave]
    if following < 0:
        return -1
    return faces[following / 3, (following % 3 + 2) % 3]


def _make_features_kernel(of_faces: Any) -> Any:
    @wp.kernel
    def _make_features(
        begin: int,
        given_tree: Tree,
        vertices: wp.array2d(dtype=wp.vec3),
        normals: wp.array(dtype=wp.float32),
        faces: wp.array2d(dtype=wp.int32),
        neighbours: wp.array2d(dtype=wp.int32),
        features: Features,
    ):
        tree = of_faces(given_tree)
        slot = begin + wp.tid()
        mesh = mesh_of_slot(tree, slot)
        one = tree_of(tree, mesh)
        scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
        face = rows_before(tree, mesh) + tree.face[slot]
        base = slots_of(one, mesh) - rows_before(tree, mesh)
        around = load_row(neighbours, face)
        at_a = faces[face, 0]
        at_b = faces[face, 1]
        at_c = faces[face, 2]
        a, b, c, _normal = load_corners(tree, slot)
        inward_ab, beyond_ab = across_edge(vertices, normals, faces, mesh, base, scale, a, b, at_b, around[0], c)
        inward_bc, beyond_bc = across_edge(vertices, normals, faces, mesh, base, scale, b, c, at_c, around[1], a)
        inward_ca, beyond_ca = across_edge(vertices, normals, faces, mesh, base, scale, c, a, at_a, around[2], b)
        first = int(-1)
        for k in range(3):
            if first < 0 and (around[3] & (CORNER << k)) != 0:
                first = k
        further = wp.vec3()
        if first >= 0:
            vertex = wp.where(first == 0, at_a, wp.where(first == 1, at_b, at_c))
            crossed = wp.where(first == 0, around[0], wp.where(first == 1, around[1], around[2]))
            end = end_of_further_edge(faces, neighbours, vertex, crossed)
            if end < 0:
                first = -1
            else:
                further = scale * vertices[mesh, end]
        total = tree.face.shape[0]
        rows = floats_at(features.rows)
        record = begin_record(rows, 4 * _FLOATS, slot)
        put4(record, 0, inward_ab[0], inward_ab[1], inward_ab[2], float(around[3]))
        put4(record, 1, inward_bc[0], inward_bc[1], inward_bc[2], float(first))
        put4(record, 2, inward_ca[0], inward_ca[1], inward_ca[2], 0.0)
        put4(record, 3, beyond_ab[0], beyond_ab[1], beyond_ab[2], further[0])
        put4(record, 4, beyond_bc[0], beyond_bc[1], beyond_bc[2], further[1])
        put4(record, 5, beyond_ca[0], beyond_ca[1], beyond_ca[2], further[2])
        end_record(rows, record, 4 * _FLOATS, slot, total)
        middle = (a + b + c) * (1.0 / 3.0)
        radius = about_root(
            wp.max(wp.length_sq(a - middle), wp.max(wp.length_sq(b - middle), wp.length_sq(c - middle)))
        )
        # A little more than rounding can take from it.
        write4(features.balls, slot, middle[0], middle[1], middle[2], 1.000001 * radius)
        ab = wp.vec3d(b) - wp.vec3d(a)
        bc = wp.vec3d(c) - wp.vec3d(b)
        ca = wp.vec3d(a) - wp.vec3d(c)
        inverses = doubles_at(features.inverses)
        record = begin_record(inverses, 8 * INVERSES, slot)
        put_double(record, 0, inverse_length(ab))
        put_double(record, 1, inverse_length(bc))
        put_double(record, 2, inverse_length(ca))
        put_double(record, 3, inverse_length(wp.cross(ab, -ca)))
        end_record(inverses, record, 8 * INVERSES, slot, total)

    return _make_features


_MAKE_FEATURES = [_make_features_kernel(own) for own in BY_FACES]


def make_features(
    tree: Tree,
    vertices: wp.array,
    normals: wp.array,
    faces: wp.array,
    neighbours: wp.array,
    features: Features,
) -> None:
    """Fill `features` from a built tree, its meshes, their normals, and the neighbours of their faces (F,4)."""
    inputs = [tree, vertices, normals, faces, neighbours, features]
    launch(_MAKE_FEATURES[not tree.meshes], tree.face.shape[0], inputs, vertices.device)
