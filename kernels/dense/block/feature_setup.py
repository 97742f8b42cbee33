"""Setup of features for a block: corners, edges and faces written so that the distance of a voxel takes a few products.

Let c be the block's centre, p a voxel from there, and m the point of a feature's plane, line or corner that is closest
to c, seen from c. The squared distances are

    corner  |p - m|^2
    line    |u - m|^2         u = p - (p.e) e, across the unit vector e
    plane   (p.n - m.n)^2     with the normal n

Near the surface they are worked out so. Far from it that would round as much as the largest of the coordinates; there
no distance is less than some L, the block's floor, and what a distance has more, squared, is of the block's size:

    corner  p.(p - 2m) + w                w = |m|^2 - L^2, in float64
    line    u.(u - 2m) + w
    plane   (p.n) (p.n - 2 m.n) + w

Only w comes from long distances. Both are sums of (t - a s) (t - b s) and w, with a = b = 1 and w = L = 0 near the
surface, and a = 0, b = 2 far away: the same few instructions. For lines, |u|^2 is |p|^2 - (p.e)^2 far away.

A line counts where p is between its ends, with room for rounding: next to them the corner is in the list too, if it can
be nearest (see `voronoi_features`). A plane counts where p projects into the face by more than rounding: next to its
edges those are in the list, and nearly as near. With room instead, a needle would reach far beyond its tip.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.culling.voronoi_features import INVERSES, Features, last_of_row, load_feature_row, one_of
from sdm.kernels.culling.witness_bound import bulge_of_edge
from sdm.kernels.dense.block.octant_tests import room_for, test_direction, test_witness
from sdm.kernels.dense.block.shared_layout import BATCH, NUMBERS, write_float, write_row
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.primitives.fast_math import about_root
from sdm.kernels.primitives.lanes import unknown
from sdm.kernels.primitives.vector_loads import load2

wp.set_module_options({"enable_backward": False})

# Kinds of features.
CORNER_KIND, EDGE_KIND, FACE_KIND = 0, 1, 2

# What rounding can add to a height inside a plane, in units of the distance from its edge.
WITHIN = 4.0e-7


@wp.func
def tests_of(kind: int):
    """Number of tests of a kind of feature: directions, and the witness."""
    return 6 - kind


@wp.func
def above_floor(square: wp.float64, floor: float):
    """Excess of a squared length over that of the floor; 0 near the surface, where the floor is 0."""
    if floor == 0.0:
        return 0.0
    return float(square - wp.float64(floor) * wp.float64(floor))


@wp.func
def directions_of_corner(
    scratch: wp.uint64,
    number: int,
    box: VoxelBox,
    k: int,
    first: wp.vec3,
    second: wp.vec3,
    third: wp.vec3,
    over_ab: wp.vec3,
    over_bc: wp.vec3,
    over_ca: wp.vec3,
    one_more: float,
    further: wp.vec3,
    room_of: float,
):
    """Write the five tests of directions of corner k of a triangle, whose neighbours' far corners are `over_...`.

    From the corner `one_more` there is one more edge, to `further`. There is so many times the room for rounding.
    """
    before = wp.where(k == 0, 2, k - 1)
    corner = one_of(k, first, second, third)
    q = corner - box.centre
    # Behind its two edges, behind the neighbours' edges there, and behind one more, if one is known.
    beyond = wp.vec3()
    if one_more == float(k):
        beyond = further - corner
    room = room_of * room_for(box, q)
    test_direction(scratch, 0, number, room, q, one_of(k, second, third, first) - corner)
    test_direction(scratch, 1, number, room, q, one_of(before, first, second, third) - corner)
    test_direction(scratch, 2, number, room, q, one_of(k, over_ab, over_bc, over_ca) - corner)
    test_direction(scratch, 3, number, room, q, one_of(before, over_ab, over_bc, over_ca) - corner)
    test_direction(scratch, 4, number, room, q, beyond)


@wp.func
def directions_of_edge(
    scratch: wp.uint64,
    number: int,
    box: VoxelBox,
    begin: wp.vec3,
    end: wp.vec3,
    normal: wp.vec3,
    inward: wp.vec3,
    room_of: float,
):
    """Write the four tests of directions of an edge of a triangle with a normal; `inward`: into its neighbour.

    There is so many times the room for rounding.
    """
    # Between its ends, outside of the face and of its neighbour.
    edge = end - begin
    p = begin - box.centre
    q = end - box.centre
    room = room_of * room_for(box, p)
    test_direction(scratch, 0, number, room, p, -edge)
    test_direction(scratch, 1, number, room_of * room_for(box, q), q, edge)
    test_direction(scratch, 2, number, room, p, wp.cross(normal, edge))
    test_direction(scratch, 3, number, room, p, inward)


@wp.func
def add_corner(
    scratch: wp.uint64,
    number: int,
    first: wp.vec3,
    second: wp.vec3,
    third: wp.vec3,
    features: Features,
    code: int,
    box: VoxelBox,
    floor: float,
):
    """Work out feature `number`, corner code % 4 of triangle code / 4: its row, and the tests of boxes.

    The triangle's corners are loaded before, for all lanes at once, whatever their features are.
    """
    slot = code / 4
    k = code % 4
    # All loads at once, four numbers at a time.
    one_more = last_of_row(features, slot, 1)
    r3 = load_feature_row(features, slot, 3)
    r4 = load_feature_row(features, slot, 4)
    r5 = load_feature_row(features, slot, 5)
    over_ab = wp.vec3(r3[0], r3[1], r3[2])
    over_bc = wp.vec3(r4[0], r4[1], r4[2])
    over_ca = wp.vec3(r5[0], r5[1], r5[2])
    corner = one_of(k, first, second, third)
    q = corner - box.centre
    m = wp.vec3d(corner) - wp.vec3d(box.centre)
    write_row(scratch, number, -q[0], -q[1], -q[2], above_floor(wp.dot(m, m), floor))
    further = wp.vec3(r3[3], r4[3], r5[3])
    directions_of_corner(
        scratch, number, box, k, first, second, third, over_ab, over_bc, over_ca, one_more, further, 1.0
    )
    test_witness(scratch, 5, number, q, 0.0)


@wp.func
def add_edge(
    scratch: wp.uint64,
    number: int,
    first: wp.vec3,
    second: wp.vec3,
    third: wp.vec3,
    normal: wp.vec3,
    features: Features,
    code: int,
    box: VoxelBox,
    floor: float,
):
    """`add_corner` for an edge, from corner code % 4 of triangle code / 4 to the next."""
    slot = code / 4
    k = code % 4
    inverse = features.inverses[INVERSES * slot + k]
    inward = load_feature_row(features, slot, k)
    begin = one_of(k, first, second, third)
    end = one_of(k, second, third, first)
    a = wp.vec3d(begin) - wp.vec3d(box.centre)
    # Not of the two from the centre, which are alike if the triangle is very small for its distance.
    ab = wp.vec3d(end) - wp.vec3d(begin)
    along = -wp.dot(a, ab) * inverse
    m = a + (along * inverse) * ab
    e = wp.vec3(inverse * ab)
    write_row(scratch, number, float(-m[0]), float(-m[1]), float(-m[2]), above_floor(wp.dot(m, m), floor))
    write_row(scratch, BATCH + number, e[0], e[1], e[2], float(-along))
    write_float(scratch, NUMBERS + number, float(wp.dot(ab, ab) * inverse - along))
    directions_of_edge(scratch, number, box, begin, end, normal, wp.vec3(inward[0], inward[1], inward[2]), 1.0)
    middle = 0.5 * ((begin - box.centre) + (end - box.centre))
    test_witness(scratch, 4, number, middle, bulge_of_edge(end - begin))


@wp.func
def add_face(
    scratch: wp.uint64,
    number: int,
    corner_a: wp.vec3,
    corner_b: wp.vec3,
    corner_c: wp.vec3,
    normal: wp.vec3,
    features: Features,
    code: int,
    box: VoxelBox,
    floor: float,
):
    """`add_corner` for a face, of triangle code / 4."""
    slot = code / 4
    # All at once: loads one after the other wait for each other.
    first_two = load2(features.inverses, 2 * slot)
    last_two = load2(features.inverses, 2 * slot + 1)
    a = wp.vec3d(corner_a) - wp.vec3d(box.centre)
    ab = wp.vec3d(corner_b) - wp.vec3d(corner_a)
    bc = wp.vec3d(corner_c) - wp.vec3d(corner_b)
    ca = wp.vec3d(corner_a) - wp.vec3d(corner_c)
    h = -wp.dot(wp.cross(ab, -ca), a) * last_two[1]
    write_row(scratch, number, normal[0], normal[1], normal[2], float(h))
    write_float(scratch, NUMBERS + number, above_floor(h * h, floor))
    # Not from a ball that is known: the middle is rounded by its distance from the centre alone.
    from_a = (2.0 * wp.vec3(ab) + wp.vec3(bc)) * (1.0 / 3.0)
    from_b = from_a - wp.vec3(ab)
    from_c = from_b - wp.vec3(bc)
    radius2 = wp.max(wp.dot(from_a, from_a), wp.max(wp.dot(from_b, from_b), wp.dot(from_c, from_c)))
    test_witness(scratch, 3, number, wp.vec3(a) + from_a, 1.000001 * radius2)
    inverse = first_two[0]
    then = first_two[1]
    last = last_two[0]
    edges = unknown(3)
    for k in range(edges):
        # The point of the edge's line that is closest to the centre: rounding is in units of its distance.
        away = wp.vec3(a - (wp.dot(a, ab) * inverse * inverse) * ab)
        u = wp.cross(normal, wp.vec3(inverse * ab))
        rounding = WITHIN * about_root(wp.dot(away, away))
        write_row(scratch, BATCH * (1 + k) + number, u[0], u[1], u[2], -wp.dot(away, u) - rounding)
        # On the inner side of the plane on this edge.
        test_direction(scratch, k, number, room_for(box, away), away, -u)
        # The next edge, turning the triangle.
        a = a + ab
        first = ab
        ab = bc
        bc = ca
        ca = first
        inverse = then
        then = last


@wp.struct
class FeatureBatch:
    """Counts of the features that are measured together: corners, edges, and all, of which the rest are faces."""

    corners: wp.int32
    edges: wp.int32
    features: wp.int32


@wp.func
def next_batch(corners: int, edges: int, faces: int, lanes: int):
    """The next features to measure, of those that wait: a full batch of one kind, or the rest of all kinds."""
    batch = FeatureBatch()
    mixed = corners < lanes and edges < lanes and faces < lanes
    if mixed or corners >= lanes:
        batch.corners = wp.min(corners, lanes)
        batch.features = batch.corners
    if mixed or (edges >= lanes and batch.features == 0):
        batch.edges = wp.min(edges, lanes - batch.features)
        batch.features = batch.features + batch.edges
    if mixed or batch.features == 0:
        batch.features = batch.features + wp.min(faces, lanes - batch.features)
    return batch


@wp.func
def kind_of(batch: FeatureBatch, feature: int):
    """The kind of a feature of a batch."""
    if feature < batch.corners:
        return CORNER_KIND
    return wp.where(feature < batch.corners + batch.edges, EDGE_KIND, FACE_KIND)
