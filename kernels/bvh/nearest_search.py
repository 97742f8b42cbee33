"""The nearest triangle to a point: best-first descent of the tree.

Float32 searches, with room for its own rounding; float64 decides among the triangles that it cannot tell apart.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, first_triangle, load_corners, node_distance2, nodes_of, slots_of
from sdm.kernels.bvh.wide_nodes import eight_boxes, eight_triangles, eights_depth, eights_leaf, eights_step
from sdm.kernels.geometry.triangle_distance import closest_point, nearest_part, part_distance2
from sdm.kernels.primitives.lanes import on_cpu

wp.set_module_options({"enable_backward": False})

# One entry a level: trees of up to 2^28 triangles are at most 27 deep.
NodeStack = wp.types.vector(length=32, dtype=wp.int32)
DistanceStack = wp.types.vector(length=32, dtype=wp.float32)
# Seven for each three levels, and eight.
WideNodeStack = wp.types.vector(length=72, dtype=wp.int32)
WideDistanceStack = wp.types.vector(length=72, dtype=wp.float32)


# Float32 tells two triangles apart if their distances differ by more than this share of the coordinates.
CLOSE = 6.0e-7


@wp.func
def slot_part(tree: Tree, slot: int, p: wp.vec3):
    """`nearest_part` for the triangle in a slot."""
    a, b, c, n = load_corners(tree, slot)
    return nearest_part(p, a, b, c, n)


@wp.func
def exact_distance2(tree: Tree, slot: int, part: int, p: wp.vec3):
    """`part_distance2` for the triangle in a slot."""
    return part_distance2(
        part,
        wp.vec3d(p),
        wp.vec3d(tree.corners[4 * slot]),
        wp.vec3d(tree.corners[4 * slot + 1]),
        wp.vec3d(tree.corners[4 * slot + 2]),
    )


@wp.func
def exact_hit(tree: Tree, slot: int, p: wp.vec3d):
    """`closest_point` for the triangle in a slot."""
    return closest_point(
        p,
        wp.vec3d(tree.corners[4 * slot]),
        wp.vec3d(tree.corners[4 * slot + 1]),
        wp.vec3d(tree.corners[4 * slot + 2]),
    )


@wp.func
def moved_square(d2: float, by: float):
    """The square of a distance that is `by` longer, or as short as zero."""
    d = wp.max(wp.sqrt(d2) + by, 0.0)
    return d * d


@wp.func
def room_at(p: wp.vec3):
    """Error bound of float32's distances from p (scaled)."""
    return CLOSE * wp.max(1.0, wp.max(wp.abs(p[0]), wp.max(wp.abs(p[1]), wp.abs(p[2]))))


@wp.func
def judged(
    tree: Tree,
    slot: int,
    p: wp.vec3,
    room: float,
    best: int,
    best_part: int,
    exact2: wp.float64,
    out2: float,
    better2: float,
):
    """The state of a search (see `nearest_slot`) after a look at the triangle in a slot."""
    d2, part = slot_part(tree, slot, p)
    if d2 < out2 and slot != best:
        wins = d2 < better2
        e2 = wp.float64(-1.0)
        if not wins:
            if exact2 < wp.float64(0.0):
                exact2 = exact_distance2(tree, best, best_part, p)
            e2 = exact_distance2(tree, slot, part, p)
            wins = e2 < exact2
            if e2 == exact2:
                wins = tree.face[slot] < tree.face[best]
        if wins:
            best = slot
            best_part = part
            exact2 = e2
            out2 = moved_square(d2, room)
            better2 = moved_square(d2, -room)
    return best, best_part, exact2, out2, better2


@wp.func
def nearest_by_eights(tree: Tree, mesh: int, p: wp.vec3, guess: int):
    """`nearest_slot` by nodes with the eight of three levels below as children, nearest first."""
    base = nodes_of(tree, mesh)
    depth = eights_depth(tree)
    pairs = tree.depth - depth
    leaves = 1 << depth
    room = room_at(p)
    best = guess
    best2, best_part = slot_part(tree, guess, p)
    out2 = moved_square(best2, room)
    better2 = moved_square(best2, -room)
    exact2 = wp.float64(-1.0)
    nodes = WideNodeStack()
    distances = WideDistanceStack()
    waiting = int(0)
    node = int(1)
    while node > 0:
        if node >= leaves:
            begin, count = eights_leaf(tree, mesh, (node - leaves) << pairs, pairs)
            squares = eight_triangles(tree.corners, begin, count, p)
            for k in range(8):
                if squares[k] < out2:
                    best, best_part, exact2, out2, better2 = judged(
                        tree, begin + k, p, room, best, best_part, exact2, out2, better2
                    )
        else:
            step = eights_step(node, depth)
            found = eight_boxes(tree.boxes, base + (node << step), 1 << step, p)
            bottom = int(waiting)
            for k in range(8):
                if found[k] < out2:
                    # In order, the nearest last.
                    at = int(waiting)
                    moving = at > bottom
                    while moving:
                        moving = distances[at - 1] < found[k]
                        if moving:
                            distances[at] = distances[at - 1]
                            nodes[at] = nodes[at - 1]
                            at = at - 1
                            moving = at > bottom
                    distances[at] = found[k]
                    nodes[at] = (node << step) + k
                    waiting = waiting + 1
        node = int(0)
        while node == 0 and waiting > 0:
            waiting = waiting - 1
            if distances[waiting] < out2:
                node = nodes[waiting]
    return best


@wp.func
def nearest_slot(tree: Tree, mesh: int, p: wp.vec3, guess: int):
    """The slot of the triangle of `mesh` nearest to p (scaled coordinates).

    `guess` is any slot of the mesh; a near one, such as the answer for a neighbouring point, saves most of the way.
    Of those that float64 finds equally near it is the one with the smallest face. There is always an answer: if every
    squared distance overflows, it is the guess.
    """
    if on_cpu():
        return nearest_by_eights(tree, mesh, p, guess)
    base = nodes_of(tree, mesh)
    leaves = 1 << tree.depth
    room = room_at(p)
    best = guess
    best2, best_part = slot_part(tree, guess, p)
    # What is further than this is out; what is nearer than that is better; float64 judges what lies between.
    out2 = moved_square(best2, room)
    better2 = moved_square(best2, -room)
    # The best triangle's distance in float64, once that was needed.
    exact2 = wp.float64(-1.0)
    nodes = NodeStack()
    distances = DistanceStack()
    waiting = int(0)
    node = int(1)
    while node > 0:
        if node >= leaves:
            leaf = node - leaves
            end = first_triangle(tree, leaf + 1)
            for t in range(first_triangle(tree, leaf), end):
                slot = slots_of(tree, mesh) + t
                best, best_part, exact2, out2, better2 = judged(
                    tree, slot, p, room, best, best_part, exact2, out2, better2
                )
            node = int(0)
        else:
            near = 2 * node
            far = near + 1
            near2 = node_distance2(tree, base + near, p)
            far2 = node_distance2(tree, base + far, p)
            if far2 < near2:
                near = far
                far = 2 * node
                swap = near2
                near2 = far2
                far2 = swap
            if far2 < out2:
                nodes[waiting] = far
                distances[waiting] = far2
                waiting = waiting + 1
            node = wp.where(near2 < out2, near, 0)
        while node == 0 and waiting > 0:
            waiting = waiting - 1
            if distances[waiting] < out2:
                node = nodes[waiting]
    return best
