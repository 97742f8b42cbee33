"""The face that a closest point is said to be on where several meet.

A closest point on an edge or a corner of the mesh is on all faces there. Of those that are as near to the query point,
to within float64's rounding (`EQUAL`), the one whose plane faces it most is named, that is with the largest |cos| of
the angle between its normal and the way from the closest point; of those whose |cos| is the same to within SAME, the
one with the smallest number. Faces that are nearly segments have no plane, and |cos| 0; of a query point on the
surface all have. Where several follow each other by less than SAME, a chain of comparisons would end with another one
in another order: so the largest |cos| is found first, then the smallest number. (Where points far apart are equally
near, `nearest_slot` takes the one of the smallest face.)

The rule depends on the mesh and the point alone, so that normals and textures that are looked up do. At an edge of two
faces with normals m and n the way is v = a m + b n with a, b >= 0, outside of a convex one. Then (v.m)^2 - (v.n)^2 =
(a^2 - b^2)(1 - (m.n)^2): the face that faces most is m where a >= b, and v.m >= a - b >= 0. So its normal tells the
side, however acute the edge is, where the other's may be wrong.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import NodeStack, WideNodeStack, exact_hit, slot_part
from sdm.kernels.bvh.tree import Tree, first_triangle, node_distance2, nodes_of, slots_of
from sdm.kernels.bvh.wide_nodes import Eight, eight_boxes, eight_triangles, eights_depth, eights_leaf, eights_step
from sdm.kernels.geometry.triangle_distance import Hit, unit_normal
from sdm.kernels.primitives.lanes import on_cpu

wp.set_module_options({"enable_backward": False})

# Room in "equally near", in units of the largest coordinate: eight times what float64 rounds.
EQUAL = wp.float64(2.0**-48)
# Nearer than this, in the same units, a query point is on the surface.
ON_SURFACE = wp.float64(2.0**-24)
# Squared distance, scaled, within which float32 takes a point of the surface to be on a triangle, or in a box.
TOUCHING2 = 4.0e-12
# Room in "faces as much".
SAME = wp.float64(1.0e-6)
# Triangles that touch a closest point and are kept on a CPU; of more the tree is gone through in each turn.
FEW = 8
FewSlots = wp.types.vector(length=FEW, dtype=wp.int32)
FewNumbers = wp.types.vector(length=FEW, dtype=wp.float64)


@wp.func
def facing(tree: Tree, slot: int, p: wp.vec3d, hit: Hit, least: wp.float64):
    """|cos| between the normal of the triangle in a slot and the way from its closest point to p; 0 within `least`."""
    way = p - hit.point
    length = wp.sqrt(hit.distance2)
    if length <= least:
        return wp.float64(0.0)
    n = unit_normal(
        wp.vec3d(tree.corners[4 * slot]), wp.vec3d(tree.corners[4 * slot + 1]), wp.vec3d(tree.corners[4 * slot + 2])
    )
    return wp.abs(wp.dot(n, way)) / length


@wp.struct
class Facing:
    """Distance and largest |cos| of the triangles that touch a closest point, as far as they were looked at."""

    least: wp.float64  # distance from the query point
    most: wp.float64  # |cos| of those that are as near, to within EQUAL
    second: wp.float64  # the next largest one, or the same again
    slot: wp.int32  # of the largest; in the end the one to name
    seen: wp.int32  # triangles but for the given one


@wp.func
def faced(tree: Tree, other: int, p: wp.vec3d, largest: wp.float64, turn: int, found: Facing):
    """The state of `facing_slot` after a look at a triangle in one of three turns; the order of looks does not matter.

    The first finds the least distance; the second, of all that are as near, the two largest |cos|; the last, of those
    whose |cos| is the same, the smallest face.
    """
    hit = exact_hit(tree, other, p)
    distance = wp.sqrt(hit.distance2)
    if turn == 0:
        found.least = wp.min(found.least, distance)
    elif distance <= found.least + EQUAL * largest:
        faces = facing(tree, other, p, hit, ON_SURFACE * largest)
        if turn == 1:
            if faces > found.most:
                found.second = found.most
                found.most = faces
                found.slot = other
            else:
                found.second = wp.max(found.second, faces)
        elif faces >= found.most - SAME and tree.face[other] < tree.face[found.slot]:
            found.slot = other
    return found


@wp.func
def touching_by_eights(tree: Tree, given: int, p: wp.vec3d, at: wp.vec3, largest: wp.float64, turn: int, found: Facing):
    """`faced` of all triangles but the given one that touch a point, by eight boxes or triangles at once."""
    base = nodes_of(tree, 0)
    depth = eights_depth(tree)
    pairs = tree.depth - depth
    leaves = 1 << depth
    nodes = WideNodeStack()
    waiting = int(1)
    nodes[0] = 1
    while waiting > 0:
        waiting = waiting - 1
        node = nodes[waiting]
        is_leaf = node >= leaves
        begin = int(0)
        step = int(3)
        squares = Eight()
        if is_leaf:
            begin, count = eights_leaf(tree, 0, (node - leaves) << pairs, pairs)
            squares = eight_triangles(tree.corners, begin, count, at)
        else:
            step = eights_step(node, depth)
            squares = eight_boxes(tree.boxes, base + (node << step), 1 << step, at)
        for back in range(8):
            k = 7 - back
            if squares[k] <= TOUCHING2:
                if not is_leaf:
                    nodes[waiting] = (node << step) + k
                    waiting = waiting + 1
                elif begin + k != given:
                    found = faced(tree, begin + k, p, largest, turn, found)
                    found.seen = found.seen + 1
    return found


@wp.func
def touching_by_nodes(tree: Tree, given: int, p: wp.vec3d, at: wp.vec3, largest: wp.float64, turn: int, found: Facing):
    """The same, node by node.

    A function of its own, as Warp makes a variable of a constant that both branches of a condition have, and what
    follows reads it, whether the condition was ever asked or not.
    """
    base = nodes_of(tree, 0)
    leaves = 1 << tree.depth
    nodes = NodeStack()
    waiting = int(0)
    node = int(1)
    while node > 0:
        if node >= leaves:
            leaf = node - leaves
            first = slots_of(tree, 0)
            for other in range(first + first_triangle(tree, leaf), first + first_triangle(tree, leaf + 1)):
                d2, _part = slot_part(tree, other, at)
                if d2 <= TOUCHING2 and other != given:
                    found = faced(tree, other, p, largest, turn, found)
                    found.seen = found.seen + 1
            node = int(0)
        else:
            left = node_distance2(tree, base + 2 * node, at) <= TOUCHING2
            right = node_distance2(tree, base + 2 * node + 1, at) <= TOUCHING2
            if left and right:
                nodes[waiting] = 2 * node + 1
                waiting = waiting + 1
            node = wp.where(left, 2 * node, wp.where(right, 2 * node + 1, 0))
        if node == 0 and waiting > 0:
            waiting = waiting - 1
            node = nodes[waiting]
    return found


@wp.func
def few_touching(tree: Tree, given: int, at: wp.vec3):
    """The triangles but for the given one that touch a point, after it, and how many all are, or more than FEW."""
    base = nodes_of(tree, 0)
    depth = eights_depth(tree)
    pairs = tree.depth - depth
    leaves = 1 << depth
    slots = FewSlots()
    slots[0] = given
    count = int(1)
    wide = WideNodeStack()
    above = int(1)
    wide[0] = 1
    while above > 0 and count <= FEW:
        above = above - 1
        at_node = wide[above]
        if at_node >= leaves:
            begin, held = eights_leaf(tree, 0, (at_node - leaves) << pairs, pairs)
            squares = eight_triangles(tree.corners, begin, held, at)
            for k in range(8):
                if squares[k] <= TOUCHING2 and begin + k != given:
                    if count < FEW:
                        slots[count] = begin + k
                    count = count + 1
        else:
            step = eights_step(at_node, depth)
            squares = eight_boxes(tree.boxes, base + (at_node << step), 1 << step, at)
            for k in range(8):
                if squares[7 - k] <= TOUCHING2:
                    wide[above] = (at_node << step) + 7 - k
                    above = above + 1
    return slots, count


@wp.func
def facing_of_few(tree: Tree, slots: FewSlots, count: int, p: wp.vec3d, largest: wp.float64, given: Hit):
    """`facing_slot` among the first of `slots`, each of which is measured once, if not `given` as the first one is."""
    distances = FewNumbers()
    cosines = FewNumbers()
    least = wp.float64(wp.inf)
    hit = given
    for k in range(count):
        if k > 0:
            hit = exact_hit(tree, slots[k], p)
        distances[k] = wp.sqrt(hit.distance2)
        least = wp.min(least, distances[k])
        if distances[k] <= least + EQUAL * largest:
            cosines[k] = facing(tree, slots[k], p, hit, ON_SURFACE * largest)
    most = wp.float64(-1.0)
    for k in range(count):
        if distances[k] <= least + EQUAL * largest:
            most = wp.max(most, cosines[k])
    named = int(slots[0])
    face = int(2147483647)
    for k in range(count):
        if distances[k] <= least + EQUAL * largest and cosines[k] >= most - SAME and tree.face[slots[k]] < face:
            named = slots[k]
            face = tree.face[named]
    return named


@wp.func
def facing_slot(tree: Tree, slot: int, p: wp.vec3d, hit: Hit):
    """The slot to name of one mesh's hierarchy, given one whose triangle is nearest to p (scaled), and its `exact_hit`.

    It is the same for each of those that are equally near.
    """
    largest = wp.max(wp.float64(1.0), wp.max(wp.abs(p[0]), wp.max(wp.abs(p[1]), wp.abs(p[2]))))
    at = wp.vec3(hit.point)
    if on_cpu():
        slots, count = few_touching(tree, slot, at)
        if count == 1:
            return slot
        if count <= FEW:
            return facing_of_few(tree, slots, count, p, largest, hit)
    found = Facing()
    found.least = wp.sqrt(hit.distance2)
    found.most = wp.float64(-1.0)
    found.second = wp.float64(-1.0)
    found.slot = slot
    turn = int(0)
    while turn < 3:
        found = faced(tree, slot, p, largest, turn, found)
        if on_cpu():
            found = touching_by_eights(tree, slot, p, at, largest, turn, found)
        else:
            found = touching_by_nodes(tree, slot, p, at, largest, turn, found)
        turn = turn + 1
        # Nothing else is there, or nothing else faces p as much.
        if found.seen == 0 or (turn == 2 and found.second < found.most - SAME):
            turn = int(3)
    return found.slot
