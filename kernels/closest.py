"""The nearest triangle to a point: best-first descent of the tree.

Float32 searches, with room for its own rounding; float64 decides among the triangles that it cannot tell apart.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.geometry import closest_point, triangle_distance2
from sdm.kernels.tree import Tree, box_distance2, first_triangle

wp.set_module_options({"enable_backward": False})

# One entry a level: trees of up to 2^28 triangles are at most 27 deep.
NodeStack = wp.types.vector(length=32, dtype=wp.int32)
DistanceStack = wp.types.vector(length=32, dtype=wp.float32)


@wp.func
def slot_distance2(tree: Tree, slot: int, p: wp.vec3):
    """Squared distance, in float32, of p from the triangle in a slot."""
    return triangle_distance2(
        p, tree.corners[4 * slot], tree.corners[4 * slot + 1], tree.corners[4 * slot + 2], tree.corners[4 * slot + 3]
    )


# Float32 tells two triangles apart if their distances differ by more than this share of the coordinates.
CLOSE = wp.constant(6.0e-7)


@wp.func
def exact_distance2(tree: Tree, slot: int, p: wp.vec3):
    """Squared distance, in float64, of p from the triangle in a slot."""
    return closest_point(
        wp.vec3d(p),
        wp.vec3d(tree.corners[4 * slot]),
        wp.vec3d(tree.corners[4 * slot + 1]),
        wp.vec3d(tree.corners[4 * slot + 2]),
    ).distance2


@wp.func
def within(distance2: wp.float64, room: float):
    """The square, in float32, of a distance and some room."""
    d = wp.sqrt(float(distance2)) + room
    return d * d


@wp.func
def nearest_slot(tree: Tree, mesh: int, p: wp.vec3, guess: int):
    """The slot of the triangle of `mesh` nearest to p (scaled coordinates).

    `guess` is any slot of the mesh; a near one, such as the answer for a neighbouring point, saves most of the way.
    There is always an answer: if every squared distance overflows, it is the guess.
    """
    base = mesh * (2 << tree.depth)
    leaves = 1 << tree.depth
    best = guess
    room = CLOSE * wp.max(1.0, wp.max(wp.abs(p[0]), wp.max(wp.abs(p[1]), wp.abs(p[2]))))
    exact2 = exact_distance2(tree, guess, p)
    best2 = within(exact2, room)
    nodes = NodeStack()
    distances = DistanceStack()
    waiting = int(0)
    node = int(1)
    while node > 0:
        if node >= leaves:
            leaf = node - leaves
            end = first_triangle(tree, leaf + 1)
            for t in range(first_triangle(tree, leaf), end):
                slot = mesh * tree.count + t
                d2 = slot_distance2(tree, slot, p)
                if d2 < best2 and slot != best:
                    e2 = exact_distance2(tree, slot, p)
                    if e2 < exact2:
                        exact2 = e2
                        best2 = within(e2, room)
                        best = slot
            node = int(0)
        else:
            near = 2 * node
            far = near + 1
            near2 = box_distance2(p, tree.low[base + near], tree.high[base + near])
            far2 = box_distance2(p, tree.low[base + far], tree.high[base + far])
            if far2 < near2:
                near = far
                far = 2 * node
                swap = near2
                near2 = far2
                far2 = swap
            if far2 < best2:
                nodes[waiting] = far
                distances[waiting] = far2
                waiting = waiting + 1
            node = wp.where(near2 < best2, near, 0)
        while node == 0 and waiting > 0:
            waiting = waiting - 1
            if distances[waiting] < best2:
                node = nodes[waiting]
    return best
