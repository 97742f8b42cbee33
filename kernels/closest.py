"""The nearest triangle to a point: best-first descent of the tree."""

from __future__ import annotations

import warp as wp

from sdm.kernels.geometry import triangle_distance2
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


@wp.func
def nearest_slot(tree: Tree, mesh: int, p: wp.vec3, guess: int):
    """The slot of the triangle of `mesh` nearest to p (scaled coordinates).

    `guess` is any slot of the mesh; a near one, such as the answer for a neighbouring point, saves most of the way.
    There is always an answer: if every squared distance overflows, it is the guess.
    """
    base = mesh * (2 << tree.depth)
    leaves = 1 << tree.depth
    best = guess
    best2 = slot_distance2(tree, guess, p)
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
                if d2 < best2:
                    best2 = d2
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
