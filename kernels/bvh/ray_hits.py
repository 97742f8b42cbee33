"""Rays through everything: how many triangles each meets, and the last one."""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import NodeStack
from sdm.kernels.bvh.tree import SCALE, Tree, first_triangle, node_box
from sdm.kernels.launch import launch

wp.set_module_options({"enable_backward": False})

# A hit is further than this from the start, in scaled coordinates: what lies on the start's own triangle is none.
START = wp.constant(wp.float64(1.0e-6))
# Directions of a box's slabs are no less than this.
SMALLEST = 1.0e-12
# Room for the rounding of boxes and slabs.
ROOM = 1.0e-5


@wp.func
def _meets_box(tree: Tree, node: int, origin: wp.vec3, inverse: wp.vec3):
    low, high = node_box(tree, node)
    to_low = wp.cw_mul(low - origin, inverse)
    to_high = wp.cw_mul(high - origin, inverse)
    first = wp.min(to_low, to_high)
    last = wp.max(to_low, to_high)
    begin = wp.max(first[0], wp.max(first[1], first[2]))
    end = wp.min(last[0], wp.min(last[1], last[2]))
    return end >= -ROOM and end - begin >= -ROOM * (1.0 + wp.abs(begin))


@wp.func
def _hit_at(tree: Tree, slot: int, origin: wp.vec3d, direction: wp.vec3d):
    """Distance along a ray to the triangle in a slot, below zero if it is not met (Moeller and Trumbore 1997)."""
    a = wp.vec3d(tree.corners[4 * slot])
    edge = wp.vec3d(tree.corners[4 * slot + 1]) - a
    other = wp.vec3d(tree.corners[4 * slot + 2]) - a
    zero = wp.float64(0.0)
    across = wp.cross(direction, other)
    volume = wp.dot(edge, across)
    found = wp.float64(-1.0)
    if volume != zero:
        away = origin - a
        u = wp.dot(away, across) / volume
        turned = wp.cross(away, edge)
        v = wp.dot(direction, turned) / volume
        if u >= zero and v >= zero and u + v <= wp.float64(1.0):
            found = wp.dot(other, turned) / volume
    return found


@wp.kernel
def _shoot(
    begin: int,
    tree: Tree,
    origins: wp.array(dtype=wp.vec3d),
    directions: wp.array(dtype=wp.vec3d),
    counts: wp.array(dtype=wp.int32),
    faces: wp.array(dtype=wp.int32),
):
    ray = begin + wp.tid()
    scale = tree.frame[SCALE]
    origin = scale * origins[ray]
    direction = directions[ray]
    start = wp.vec3(origin)
    inverse = wp.vec3(0.0, 0.0, 0.0)
    for axis in range(3):
        along = float(direction[axis])
        if wp.abs(along) < SMALLEST:
            along = SMALLEST
        inverse[axis] = 1.0 / along
    leaves = 1 << tree.depth
    count = int(0)
    last = wp.float64(0.0)
    face = int(-1)
    nodes = NodeStack()
    waiting = int(0)
    node = wp.where(_meets_box(tree, 1, start, inverse), 1, 0)
    while node > 0:
        if node >= leaves:
            end = first_triangle(tree, node - leaves + 1)
            for slot in range(first_triangle(tree, node - leaves), end):
                at = _hit_at(tree, slot, origin, direction)
                if at > START:
                    count = count + 1
                    if at > last:
                        last = at
                        face = tree.face[slot]
            node = int(0)
        else:
            left = 2 * node
            hit_left = _meets_box(tree, left, start, inverse)
            hit_right = _meets_box(tree, left + 1, start, inverse)
            node = wp.where(hit_left, left, wp.where(hit_right, left + 1, 0))
            if hit_left and hit_right:
                nodes[waiting] = left + 1
                waiting = waiting + 1
        if node == 0 and waiting > 0:
            waiting = waiting - 1
            node = nodes[waiting]
    counts[ray] = count
    faces[ray] = face


def shoot(tree: Tree, origins: wp.array, directions: wp.array, counts: wp.array, faces: wp.array) -> None:
    """Follow rays through all of one mesh's triangles.

    Args:
        tree: The hierarchy.
        origins: (N,) vec3d, in the mesh's unit.
        directions: (N,) vec3d, of length 1.
        counts: (N,) int32, filled: how many triangles each meets.
        faces: (N,) int32, filled: the last one, -1 if there is none.
    """
    launch(_shoot, origins.shape[0], [tree, origins, directions, counts, faces], counts.device)
