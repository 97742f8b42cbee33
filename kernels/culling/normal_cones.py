"""Normal cones: bounds on the way that the surface faces, for each triangle and each small node of the tree.

Let x be the point of the surface that is nearest to p. Then p - x makes no angle of less than a right one with any way
along the surface from x, and that bounds it by the normals of the faces around x:

- x inside a face: p - x is along its normal, one way or the other;
- x inside an edge of two faces with unit vectors u, v across it: p - x is at right angles to the edge and between the
  faces' normals (outside of both), as (p - x).u <= 0 and (p - x).v <= 0;
- x on a corner whose faces close a ring, with edges e_1 .. e_k in order: (p - x).e_i <= 0 for all of them. Scale the
  edges so that e_i = q_i - d with q_i at right angles to d = (p - x)/|p - x| (if some (p - x).e_i = 0, take a limit).
  The sum of all e_i x e_i+1 is then 2 A d, where A is the signed area of the polygon of the q_i. These products are
  the faces' normals times positive numbers, so d or -d is in the cone that they span. (A = 0 would make the sum zero,
  which it is not if all normals are on one side of a plane.)

So if all those normals are within an angle of T of one unit vector n, up to their common sign, then so is p - x: a cone
with axis n and half-angle T, to both sides, for the features that a triangle owns (see `voronoi_features`). A boundary
edge, a ring that does not close and a triangle without a normal give T = 90 degrees: all directions. Nothing is asked
of the mesh: other faces at the same edge or corner only narrow the directions down.

A cluster whose points are in a ball of centre m and radius r has nothing nearest to any point of a box of centre c
and radius R if the vector c - m is further than r + R from the cone, as p - x is within r + R of c - m. The distance
of d from a double cone is |d - (d.n) n| cos T - |d.n| sin T.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import BY_FACES, Tree, first_triangle, mesh_of_slot, nodes_of, rows_before, slots_of, tree_of
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.launch import launch
from sdm.kernels.primitives.fast_math import about_root
from sdm.kernels.primitives.lanes import GPU_LANES, wait_for_lanes
from sdm.kernels.primitives.vector_loads import load4, load_row, read4, write4

wp.set_module_options({"enable_backward": False})

# Faces around a corner that are looked at before it counts as one that faces everywhere.
MOST_AROUND = 32
# Levels of the tree, from the leaves up, whose nodes have cones: wider ones face everywhere, or nearly.
LEVELS = 6
# More than rounding can take from an angle, and what it adds to a distance, in shares of the longer vectors.
ANGLE_ROOM = 2.0e-5
DISTANCE_ROOM = 2.0e-6
# Beyond this half-angle a cone is as good as none.
WIDEST = 1.5
# Instead of a squared sine: every direction.
NONE = 2.0


@wp.struct
class Cones:
    """Four floats each: the axis n, and sin T; 1 where every direction counts, -1 where there is nothing."""

    triangles: wp.array(dtype=wp.float32)  # (slots * 4)
    nodes: wp.array(dtype=wp.float32)  # (meshes * 2^(depth+1) * 4), filled for LEVELS levels above the leaves


@wp.func
def cone_misses(box: VoxelBox, radius: float, middle: wp.vec3, extent: float, cone: wp.vec4):
    """True if nothing in the ball (`middle`, `extent`) with this cone is nearest to a point of the box of `radius`."""
    if cone[3] >= 1.0:
        return False
    axis = wp.vec3(cone[0], cone[1], cone[2])
    d = box.centre - middle
    along = wp.dot(d, axis)
    across = d - along * axis
    aside = about_root(wp.dot(across, across))
    cosine = about_root(1.0 - cone[3] * cone[3])
    room = DISTANCE_ROOM * (wp.abs(along) + aside + about_root(wp.dot(box.centre, box.centre)))
    return aside * cosine - wp.abs(along) * cone[3] > (extent + radius) * (1.0 + DISTANCE_ROOM) + room


@wp.func
def sine2_between(m: wp.vec3, n: wp.vec3):
    """The squared sine of the angle between two unit normals; NONE beyond a right angle, or without one of them.

    Not by the cosine, from which rounding takes much of a small angle.
    """
    if wp.dot(m, n) <= 0.0:
        return NONE
    across = wp.cross(m, n)
    return wp.dot(across, across)


@wp.func
def normal_of(normals: wp.array(dtype=wp.float32), base: int, face: int):
    """The normal of a face of the mesh whose faces' normals begin `base` after where its faces do."""
    n = load4(normals, base + face)
    return wp.vec3(n[0], n[1], n[2])


@wp.func
def sine2_over_edge(
    normals: wp.array(dtype=wp.float32),
    faces: wp.array2d(dtype=wp.int32),
    base: int,
    mine: wp.vec3,
    end: int,
    other: int,
):
    """Squared sine of the angle between a face's normal and its neighbour's at an edge; NONE if there is none.

    The edge ends at the vertex `end`, and `other` is 3 * face + edge. A neighbour that goes along it the same way has
    its normal on the other side.
    """
    if other < 0:
        return NONE
    theirs = normal_of(normals, base, other / 3)
    if faces[other / 3, other % 3] != end:
        theirs = -theirs
    return sine2_between(mine, theirs)


@wp.func
def sine2_around_corner(
    normals: wp.array(dtype=wp.float32),
    faces: wp.array2d(dtype=wp.int32),
    neighbours: wp.array2d(dtype=wp.int32),
    base: int,
    face: int,
    mine: wp.vec3,
    k: int,
    index: int,
    code: int,
):
    """The largest squared sine of the angles between a face's normal and those of the ring around its corner k.

    NONE if the ring does not close, or one of its faces has no normal. The corner is the vertex `index`, and `code` the
    first neighbour.
    """
    most = float(0.0)
    for _step in range(MOST_AROUND):
        if code < 0:
            return NONE
        there = code / 3
        entered = code % 3
        if there == face:
            return wp.where(entered == (k + 2) % 3, most, NONE)
        # All of these before any is used, as each takes long to come.
        near = faces[there, entered]
        around = load_row(neighbours, there)
        theirs = normal_of(normals, base, there)
        left = wp.where(near == index, (entered + 2) % 3, (entered + 1) % 3)
        if near != index:
            theirs = -theirs
        most = wp.max(most, sine2_between(mine, -theirs))
        if most >= NONE:
            return NONE
        code = wp.where(left == 0, around[0], wp.where(left == 1, around[1], around[2]))
    return NONE


def _cones_of_triangles_kernel(of_faces: Any) -> Any:
    @wp.kernel
    def _cones_of_triangles(
        begin: int,
        given_tree: Tree,
        normals: wp.array(dtype=wp.float32),
        faces: wp.array2d(dtype=wp.int32),
        neighbours: wp.array2d(dtype=wp.int32),
        cones: Cones,
    ):
        tree = of_faces(given_tree)
        slot = begin + wp.tid()
        mesh = mesh_of_slot(tree, slot)
        one = tree_of(tree, mesh)
        face = rows_before(tree, mesh) + tree.face[slot]
        base = slots_of(one, mesh) - rows_before(tree, mesh)
        around = load_row(neighbours, face)
        owned = around[3]
        axis = normal_of(normals, base, face)
        most = float(0.0)
        if wp.dot(axis, axis) < 0.5:
            most = NONE
        for k in range(3):
            if (owned >> (k + 3)) & 1 and most < NONE:
                end = faces[face, (k + 1) % 3]
                most = wp.max(most, sine2_over_edge(normals, faces, base, axis, end, around[k]))
        for k in range(3):
            if (owned >> k) & 1 and most < NONE:
                index = faces[face, k]
                most = wp.max(
                    most, sine2_around_corner(normals, faces, neighbours, base, face, axis, k, index, around[k])
                )
        sine = float(1.0)
        if most < NONE:
            sine = wp.min(wp.sqrt(most) + ANGLE_ROOM, 1.0)
        write4(cones.triangles, slot, axis[0], axis[1], axis[2], sine)

    return _cones_of_triangles


_CONES_OF_TRIANGLES = [_cones_of_triangles_kernel(own) for own in BY_FACES]


@wp.func
def merged(a: wp.vec4, b: wp.vec4):
    """The least cone around two."""
    if a[3] < 0.0:
        return b
    if b[3] < 0.0:
        return a
    if a[3] >= 1.0 or b[3] >= 1.0:
        return wp.vec4(0.0, 0.0, 0.0, 1.0)
    m = wp.vec3(a[0], a[1], a[2])
    n = wp.vec3(b[0], b[1], b[2])
    if wp.dot(m, n) < 0.0:
        n = -n
    between = wp.atan2(wp.length(wp.cross(m, n)), wp.dot(m, n))
    of_a = wp.asin(a[3])
    of_b = wp.asin(b[3])
    if of_a >= between + of_b:
        return a
    if of_b >= between + of_a:
        return b
    angle = 0.5 * (between + of_a + of_b)
    axis = m
    if between > ANGLE_ROOM:
        turn = angle - of_a
        axis = wp.normalize(wp.sin(between - turn) * m + wp.sin(turn) * n)
    else:
        angle = wp.max(of_a, of_b) + between
    if angle >= WIDEST:
        return wp.vec4(0.0, 0.0, 0.0, 1.0)
    return wp.vec4(axis[0], axis[1], axis[2], wp.min(wp.sin(angle) + ANGLE_ROOM, 1.0))


@wp.func
def cone_of_leaf(tree: Tree, cones: Cones, mesh: int, leaf: int):
    cone = wp.vec4(0.0, 0.0, 0.0, -1.0)
    for t in range(first_triangle(tree, leaf), first_triangle(tree, leaf + 1)):
        cone = merged(cone, read4(cones.triangles, slots_of(tree, mesh) + t))
    return cone


def _cones_of_levels_kernel(of_faces: Any) -> Any:
    @wp.kernel
    def _cones_of_levels(begin: int, lanes: int, given_tree: Tree, width: int, cones: Cones):
        """Cones of the lowest levels: a group of lanes for each node of the highest, and `width` groups a mesh."""
        tree = of_faces(given_tree)
        thread = begin + wp.tid()
        lane = thread % lanes
        group = thread / lanes
        mesh = group / width
        one = tree_of(tree, mesh)
        highest = wp.max(one.depth - LEVELS, 0)
        levels = one.depth - highest + 1
        top = (1 << highest) + group - mesh * width
        # Of meshes that differ, one with fewer levels takes fewer groups.
        if top >= 2 << highest:
            return
        leaves = 1 << one.depth
        base = nodes_of(one, mesh)
        for back in range(levels):
            down = levels - 1 - back
            node = (top << down) + lane
            while node < (top + 1) << down:
                cone = wp.vec4()
                if node >= leaves:
                    cone = cone_of_leaf(one, cones, mesh, node - leaves)
                else:
                    left = base + 2 * node
                    cone = merged(read4(cones.nodes, left), read4(cones.nodes, left + 1))
                write4(cones.nodes, base + node, cone[0], cone[1], cone[2], cone[3])
                node = node + lanes
            wait_for_lanes()

    return _cones_of_levels


_CONES_OF_LEVELS = [_cones_of_levels_kernel(own) for own in BY_FACES]


@wp.func
def node_cone(tree: Tree, cones: Cones, base: int, node: int):
    """The cone of node `node` of the mesh whose nodes begin at `base`: every direction for the large ones."""
    cone = wp.vec4(0.0, 0.0, 0.0, 1.0)
    if node >= (1 << wp.max(tree.depth + tree.below - LEVELS, 0)):
        cone = load4(cones.nodes, base + node)
    return cone


def make_cones(tree: Tree, normals: wp.array, faces: wp.array, neighbours: wp.array, cones: Cones) -> None:
    """Fill `cones` from a built tree, the faces' `normals` (see there) and their neighbours (F,4)."""
    device, slots = normals.device, normals.shape[0] // 4
    meshes = tree.meshes or slots // tree.count
    launch(_CONES_OF_TRIANGLES[not tree.meshes], slots, [tree, normals, faces, neighbours, cones], device)
    lanes = GPU_LANES if device.is_cuda else 1
    top = max(tree.depth - int(LEVELS), 0)
    inputs = [lanes, tree, 1 << top, cones]
    launch(_CONES_OF_LEVELS[not tree.meshes], (meshes << top) * lanes, inputs, device, smallest=8)
