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
distances are smaller than the block, and are taken from p - m, its part across the line, or the height.

A line counts where p is between its ends, with room for rounding: next to them the corner is in the list too, if it can
be nearest (see `parts`). A plane counts where p projects into the face by more than rounding: next to its edges those
are in the list, and nearly as near. With room instead, a needle would reach far beyond its tip.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.cull import Cell
from sdm.kernels.lanes import has_turn
from sdm.kernels.octants import Bounds
from sdm.kernels.parts import INVERSES, PARTS_FLOATS, Parts
from sdm.kernels.rows import (
    CORNERS,
    EDGE_ROW,
    EDGES,
    ENDS,
    FACE_ROW,
    FACES,
    OFFSETS,
    write_number,
    write_row,
)
from sdm.kernels.tree import Tree, load_corners

wp.set_module_options({"enable_backward": False})

_FACES, _EDGES, _CORNERS = wp.constant(FACES), wp.constant(EDGES), wp.constant(CORNERS)
_EDGE_ROW, _FACE_ROW = wp.constant(EDGE_ROW), wp.constant(FACE_ROW)
_ENDS, _OFFSETS = wp.constant(ENDS), wp.constant(OFFSETS)
_INVERSES, _PARTS_FLOATS = wp.constant(INVERSES), wp.constant(PARTS_FLOATS)
# What rounding can add to a height inside a plane, in units of the distance from its edge.
WITHIN = wp.constant(4.0e-7)


@wp.struct
class Counts:
    """How many of each kind are in a block's lists."""

    corners: wp.int32
    edges: wp.int32
    faces: wp.int32


@wp.func
def added(some: Counts, more: Counts):
    """The sum of two counts."""
    found = Counts()
    found.corners = some.corners + more.corners
    found.edges = some.edges + more.edges
    found.faces = some.faces + more.faces
    return found


@wp.func
def less(some: Counts, fewer: Counts):
    """The difference of two counts."""
    found = Counts()
    found.corners = some.corners - fewer.corners
    found.edges = some.edges - fewer.edges
    found.faces = some.faces - fewer.faces
    return found


@wp.func
def has_room(counts: Counts, taken: Counts):
    """Whether so many more parts fit into the lists."""
    total = added(counts, taken)
    return total.faces <= _FACES and total.edges <= _EDGES and total.corners <= _CORNERS


@wp.func
def row_vector(parts: Parts, slot: int, first: int):
    """Three of the numbers that `parts` keeps of a triangle."""
    at = _PARTS_FLOATS * slot + first
    return wp.vec3(parts.rows[at], parts.rows[at + 1], parts.rows[at + 2])


@wp.func
def add_corner(rows: wp.uint64, number: int, tree: Tree, parts: Parts, code: int, cell: Cell, radius2: float):
    """Row `number` of the corners: corner code % 4 of triangle code / 4. Returns what bounds where it matters."""
    slot = code / 4
    k = code % 4
    after = wp.where(k == 2, 0, k + 1)
    before = wp.where(k == 0, 2, k - 1)
    corner = tree.corners[code]
    a = wp.vec3d(corner) - wp.vec3d(cell.centre)
    v = -2.0 * wp.vec3(a)
    write_row(rows, number, v[0], v[1], v[2], float(wp.dot(a, a) - wp.float64(radius2)))
    # Behind its two edges, and behind the neighbours' edges there.
    bounds = Bounds()
    q = corner - cell.centre
    bounds.q0 = q
    bounds.u0 = tree.corners[4 * slot + after] - corner
    bounds.q1 = q
    bounds.u1 = tree.corners[4 * slot + before] - corner
    bounds.q2 = q
    bounds.u2 = row_vector(parts, slot, 9 + 3 * k) - corner
    bounds.q3 = q
    bounds.u3 = row_vector(parts, slot, 9 + 3 * before) - corner
    return bounds


@wp.func
def add_edge(rows: wp.uint64, number: int, tree: Tree, parts: Parts, code: int, cell: Cell, radius2: float):
    """Rows of edge `number`: from corner code % 4 of triangle code / 4 to the next. Returns what bounds it."""
    slot = code / 4
    k = code % 4
    inverse = parts.inverses[_INVERSES * slot + k]
    inward = row_vector(parts, slot, 3 * k)
    begin, end, third, normal = load_corners(tree, slot)
    if k == 1:
        begin = end
        end = third
    if k == 2:
        end = begin
        begin = third
    a = wp.vec3d(begin) - wp.vec3d(cell.centre)
    # Not of the two from the centre, which are alike if the triangle is very small for its distance.
    ab = wp.vec3d(end) - wp.vec3d(begin)
    along = -wp.dot(a, ab) * inverse
    m = a + (along * inverse) * ab
    e = wp.vec3(inverse * ab)
    m2 = -2.0 * wp.vec3(m)
    row = _EDGE_ROW + number
    write_row(rows, row, m2[0], m2[1], m2[2], float(wp.dot(m, m) - wp.float64(radius2)))
    write_row(rows, row + _EDGES, e[0], e[1], e[2], float(-along))
    write_number(rows, _ENDS + number, float(wp.length(ab) - along))
    # Between its ends, outside of the face and of its neighbour.
    bounds = Bounds()
    edge = end - begin
    q = begin - cell.centre
    bounds.q0 = q
    bounds.u0 = -edge
    bounds.q1 = end - cell.centre
    bounds.u1 = edge
    bounds.q2 = q
    bounds.u2 = wp.cross(normal, edge)
    bounds.q3 = q
    bounds.u3 = inward
    return bounds


@wp.func
def add_face(rows: wp.uint64, number: int, tree: Tree, parts: Parts, code: int, cell: Cell, radius2: float):
    """Rows of face `number`: triangle code / 4. Returns what bounds it."""
    slot = code / 4
    inverses = wp.vec4d()
    # All at once: loads one after the other wait for each other.
    for k in range(4):
        inverses[k] = parts.inverses[_INVERSES * slot + k]
    corner_a, corner_b, corner_c, normal = load_corners(tree, slot)
    a = wp.vec3d(corner_a) - wp.vec3d(cell.centre)
    ab = wp.vec3d(corner_b) - wp.vec3d(corner_a)
    bc = wp.vec3d(corner_c) - wp.vec3d(corner_b)
    ca = wp.vec3d(corner_a) - wp.vec3d(corner_c)
    row = _FACE_ROW + number
    h = -wp.dot(wp.cross(ab, -ca), a) * inverses[3]
    write_row(rows, row, normal[0], normal[1], normal[2], 2.0 * float(h))
    write_number(rows, _OFFSETS + number, float(h * h - wp.float64(radius2)))
    # On the inner sides of the planes on its edges.
    bounds = Bounds()
    inverse = inverses[0]
    then = inverses[1]
    last = inverses[2]
    k = int(0)
    while has_turn(k, 3):
        # The point of the edge's line that is closest to the centre: rounding is in units of its distance.
        away = wp.vec3(a - (wp.dot(a, ab) * inverse * inverse) * ab)
        u = wp.cross(normal, wp.vec3(inverse * ab))
        write_row(rows, row + _FACES * (1 + k), u[0], u[1], u[2], -wp.dot(away, u) - WITHIN * wp.length(away))
        bounds.q2 = bounds.q1
        bounds.u2 = bounds.u1
        bounds.q1 = bounds.q0
        bounds.u1 = bounds.u0
        bounds.q0 = away
        bounds.u0 = -u
        # The next edge, turning the triangle.
        a = a + ab
        first = ab
        ab = bc
        bc = ca
        ca = first
        inverse = then
        then = last
        k = k + 1
    # There is no fourth.
    bounds.q3 = bounds.q2
    bounds.u3 = bounds.u2
    return bounds
