"""Closest points of a map's voxels, from the feature that each voxel's distance is from.

A map knows for each voxel which corner, edge or face its distance was measured to (`dense.block.winners`), so nothing
is searched for again: the closest point is worked out on that feature in float64. One of the faces there is named by
the rule of `facing`, of an edge among all its faces, and of a corner among those that one comes to by going from face
to face around it: to the left, and from a border to the right. What takes the rule further for points, other triangles
that only touch there, is not looked for. Where a search found the triangle the rule is that of points, to the letter.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import exact_hit
from sdm.kernels.bvh.tree import SCALE, UNSCALE, Tree
from sdm.kernels.closest.facing import ON_SURFACE, SAME, facing_slot
from sdm.kernels.closest.hits import Hits
from sdm.kernels.geometry.triangle_distance import segment_parameter, unit_normal
from sdm.kernels.geometry.voxel_grid import SEARCHED, Slab, unravel, voxel
from sdm.kernels.launch import launch

wp.set_module_options({"enable_backward": False})

# Faces that are gone to around a corner, or at an edge, in each direction.
MOST_AROUND = 64


@wp.struct
class Surroundings:
    """A mesh's faces, and which of them meet."""

    vertices: wp.array(dtype=wp.vec3)
    faces: wp.array2d(dtype=wp.int32)  # (F, 3)
    neighbours: wp.array2d(dtype=wp.int32)  # (F, 4), see `topology.edge_pairing`


@wp.struct
class Named:
    """The face that is named so far, and the one with the largest |cos|."""

    place: wp.int32  # 3 * face + corner, where the edge begins or the corner is
    back: wp.int32  # 1 if the edge leads the other way there
    cos: wp.float64
    most: wp.float64


@wp.func
def corner_of(around: Surroundings, scale: wp.float64, face: int, corner: int):
    """A corner of a face, scaled."""
    return scale * wp.vec3d(around.vertices[around.faces[face, corner]])


@wp.func
def cos_of(around: Surroundings, scale: wp.float64, face: int, way: wp.vec3d):
    """|cos| between a face's normal and a unit vector, or 0 for a zero vector."""
    a = corner_of(around, scale, face, 0)
    b = corner_of(around, scale, face, 1)
    c = corner_of(around, scale, face, 2)
    return wp.abs(wp.dot(unit_normal(a, b, c), way))


@wp.func
def better(around: Surroundings, scale: wp.float64, way: wp.vec3d, named: Named, place: int, back: int):
    """The face that is named once another one was looked at: as `facing_slot` has it."""
    face = place / 3
    cos = cos_of(around, scale, face, way)
    wins = (cos >= named.most - SAME and face < named.place / 3) or cos > named.cos + SAME
    found = named
    found.most = wp.max(named.most, cos)
    if wins:
        found.place = place
        found.back = back
        found.cos = cos
    return found


@wp.func
def at_edge(around: Surroundings, scale: wp.float64, way: wp.vec3d, first: Named):
    """The face to name at an edge."""
    named = first
    start = int(first.place)
    begin = around.faces[start / 3, start % 3]
    other = around.neighbours[start / 3, start % 3]
    steps = int(0)
    while other >= 0 and other != start and steps < MOST_AROUND:
        back = wp.where(around.faces[other / 3, other % 3] == begin, 0, 1)
        named = better(around, scale, way, named, other, back)
        other = around.neighbours[other / 3, other % 3]
        steps = steps + 1
    return named


@wp.func
def around_corner(around: Surroundings, scale: wp.float64, way: wp.vec3d, first: Named):
    """The face to name at a corner."""
    named = first
    face = first.place / 3
    first_corner = first.place % 3
    vertex = around.faces[face, first_corner]
    for turn in range(2):
        # Over the edge that begins at the corner, or over the one that ends there.
        other = around.neighbours[face, (first_corner + 2 * turn) % 3]
        steps = int(0)
        while other >= 0 and other / 3 != face and steps < MOST_AROUND:
            there = other / 3
            side = other % 3
            following = (side + 1) % 3
            corner = int(following)
            leave = int(following)
            if around.faces[there, following] != vertex:
                corner = side
                leave = (side + 2) % 3
            named = better(around, scale, way, named, 3 * there + corner, 0)
            other = around.neighbours[there, leave]
            steps = steps + 1
        if other >= 0:
            # All the way round.
            break
    return named


@wp.func
def write_hit(tree: Tree, around: Surroundings, hits: Hits, number: int, face: int, weights: wp.vec3d):
    """Write a closest point by its barycentric coordinates on a face."""
    scale = tree.frame[SCALE]
    point = weights[0] * corner_of(around, scale, face, 0) + weights[1] * corner_of(around, scale, face, 1)
    point = point + weights[2] * corner_of(around, scale, face, 2)
    hits.points[number] = wp.vec3(tree.frame[UNSCALE] * point)
    hits.faces[number] = face
    hits.barycentric[number] = wp.vec3(weights)


@wp.func
def weights_at(corner: int, at_corner: wp.float64, at_next: wp.float64):
    """Barycentric coordinates that are zero but for those of a corner and of the next."""
    zero = wp.float64(0.0)
    if corner == 0:
        return wp.vec3d(at_corner, at_next, zero)
    if corner == 1:
        return wp.vec3d(zero, at_corner, at_next)
    return wp.vec3d(at_next, zero, at_corner)


@wp.func
def weights_above(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Barycentric coordinates of the point of a triangle that p projects to, not less than zero.

    It projects inside by a float32 test, which a rounding may have passed.
    """
    zero = wp.float64(0.0)
    n = wp.cross(b - a, c - a)
    weights = wp.vec3d(
        wp.max(wp.dot(n, wp.cross(c - b, p - b)), zero),
        wp.max(wp.dot(n, wp.cross(a - c, p - c)), zero),
        wp.max(wp.dot(n, wp.cross(b - a, p - a)), zero),
    )
    return weights / (weights[0] + weights[1] + weights[2])


@wp.kernel
def _name_measured(begin: int, tree: Tree, slab: Slab, around: Surroundings, hits: Hits):
    number = begin + wp.tid()
    winner = hits.faces[number]
    if winner < 0:
        hits.faces[number] = -1 - winner
        return
    part = winner % 8
    _mesh, at = unravel(number, slab.shape)
    scale = tree.frame[SCALE]
    p = scale * wp.vec3d(voxel(slab, at[0], at[1], at[2]))
    face = tree.face[winner / 8]
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    if part == 6:
        a = corner_of(around, scale, face, 0)
        b = corner_of(around, scale, face, 1)
        c = corner_of(around, scale, face, 2)
        write_hit(tree, around, hits, number, face, weights_above(p, a, b, c))
    else:
        corner = part % 3
        point = corner_of(around, scale, face, corner)
        along = wp.float64(0.0)
        if part >= 3:
            edge = corner_of(around, scale, face, (corner + 1) % 3) - point
            along = segment_parameter(p - point, edge)
            point = point + along * edge
        way = p - point
        length = wp.length(way)
        least = ON_SURFACE * wp.max(one, wp.max(wp.abs(p[0]), wp.max(wp.abs(p[1]), wp.abs(p[2]))))
        way = wp.where(length > least, way / length, wp.vec3d(zero, zero, zero))
        named = Named()
        named.place = 3 * face + corner
        named.cos = cos_of(around, scale, face, way)
        named.most = named.cos
        if part >= 3:
            named = at_edge(around, scale, way, named)
            if named.back != 0:
                along = one - along
        else:
            named = around_corner(around, scale, way, named)
        write_hit(tree, around, hits, number, named.place / 3, weights_at(named.place % 3, one - along, along))


@wp.kernel
def _name_searched(begin: int, tree: Tree, slab: Slab, hits: Hits):
    number = begin + wp.tid()
    winner = hits.faces[number]
    if winner % 8 == SEARCHED:
        _mesh, at = unravel(number, slab.shape)
        p = tree.frame[SCALE] * wp.vec3d(voxel(slab, at[0], at[1], at[2]))
        slot = facing_slot(tree, winner / 8, p)
        hit = exact_hit(tree, slot, p)
        hits.points[number] = wp.vec3(tree.frame[UNSCALE] * hit.point)
        hits.barycentric[number] = wp.vec3(hit.barycentric)
        # Told apart from winners, until these are done.
        hits.faces[number] = -1 - tree.face[slot]


def name_voxels(tree: Tree, slab: Slab, around: Surroundings, hits: Hits) -> None:
    """Fill `hits` for the voxels of one mesh's slab from their winners, which `hits.faces` holds."""
    count = hits.faces.shape[0]
    launch(_name_searched, count, [tree, slab, hits], hits.faces.device)
    launch(_name_measured, count, [tree, slab, around, hits], hits.faces.device)
