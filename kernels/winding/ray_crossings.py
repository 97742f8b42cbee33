"""Integer winding numbers of closed meshes, exactly: count signed crossings of a ray along +x.

A ray that leaves through a face counts +1, one that enters -1; for a closed mesh the sum is its winding number at
the ray's start, whatever overlaps, touches or is inside out. The danger is a ray through an edge or a corner. Here
the (y,z) of every vertex and ray is snapped to one lattice of integers, a move far below a float32 rounding, and
"left of an edge" is an integer cross product, so it is never rounded. Ties are broken by moving the ray by
(-epsilon^2, +epsilon) in (y,z): with edges directed upward in (y, then z) that means "zero is left". The two faces
at an edge thus always agree, and a closed mesh always adds up.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import NodeStack
from sdm.kernels.bvh.tree import Tree, first_triangle, node_box, nodes_of, slots_of, to_lattice

wp.set_module_options({"enable_backward": False})

# A ray's room across it: more than a step of the lattice and a rounding of the sum, in scaled units and relative.
RAY_ROOM = 1.2e-7


@wp.func
def cross2(a: wp.vec2i, b: wp.vec2i, p: wp.vec2i):
    """Twice the signed area of (a,b,p) on the lattice, exactly."""
    return wp.int64(b[0] - a[0]) * wp.int64(p[1] - a[1]) - wp.int64(b[1] - a[1]) * wp.int64(p[0] - a[0])


@wp.func
def is_left(a: wp.vec2i, b: wp.vec2i, p: wp.vec2i):
    """True if the ray at p passes to the left of the edge a -> b; always the opposite for b -> a."""
    zero = wp.int64(0)
    if a[0] < b[0] or (a[0] == b[0] and a[1] < b[1]):
        return cross2(a, b, p) >= zero
    return cross2(b, a, p) < zero


@wp.func
def covers(a: wp.vec2i, b: wp.vec2i, c: wp.vec2i, p: wp.vec2i):
    """+1 or -1 if the ray at p meets the projected triangle (counter-clockwise or clockwise), else 0."""
    left = is_left(a, b, p)
    if is_left(b, c, p) != left or is_left(c, a, p) != left:
        return 0
    # A triangle without projected area is met edge-on, if at all, which is no crossing.
    if cross2(a, b, c) == wp.int64(0):
        return 0
    return wp.where(left, 1, -1)


@wp.func
def crossing_of(a: wp.vec2i, b: wp.vec2i, c: wp.vec2i, ax: float, bx: float, cx: float, p: wp.vec2i):
    """Crossing of the ray at p with a triangle (scaled x); ax, bx and cx are its corners'."""
    weight_a = wp.float64(cross2(b, c, p))
    weight_b = wp.float64(cross2(c, a, p))
    weight_c = wp.float64(cross2(a, b, p))
    xa = wp.float64(ax)
    xb = wp.float64(bx)
    xc = wp.float64(cx)
    x = (weight_a * xa + weight_b * xb + weight_c * xc) / (weight_a + weight_b + weight_c)
    # Rounding must not carry it off a triangle that stands across the ray.
    return wp.clamp(x, wp.min(xa, wp.min(xb, xc)), wp.max(xa, wp.max(xb, xc)))


@wp.func
def crossing_x(tree: Tree, slot: int, p: wp.vec2i):
    """Crossing of the ray at p with the triangle in a slot (scaled x)."""
    return crossing_of(
        tree.lattice[3 * slot],
        tree.lattice[3 * slot + 1],
        tree.lattice[3 * slot + 2],
        tree.corners[4 * slot][0],
        tree.corners[4 * slot + 1][0],
        tree.corners[4 * slot + 2][0],
        p,
    )


@wp.func
def crossing_on_ray(tree: Tree, slot: int, q: wp.vec2i, x: wp.float64, back: bool):
    """+1 or -1 if the ray at q from x (scaled) along +x, or at x and along -x, meets the triangle in a slot, else 0."""
    sign = covers(tree.lattice[3 * slot], tree.lattice[3 * slot + 1], tree.lattice[3 * slot + 2], q)
    if sign != 0:
        if (crossing_x(tree, slot, q) > x) == back:
            return 0
    return sign


@wp.func
def lattice_box(tree: Tree, slot: int):
    """The lowest and the highest (y,z) on the lattice of the triangle in a slot."""
    a = tree.lattice[3 * slot]
    b = tree.lattice[3 * slot + 1]
    c = tree.lattice[3 * slot + 2]
    return wp.min(a, wp.min(b, c)), wp.max(a, wp.max(b, c))


@wp.struct
class Ray:
    """A ray along x, with room for the lattice and for rounding across it: it may seem to meet more than it does."""

    x: float
    back: wp.int32  # towards -x
    low_y: float
    high_y: float
    low_z: float
    high_z: float


@wp.func
def ray_from(p: wp.vec3d, back: bool):
    """The ray from p (scaled, and float32's) along +x, or along -x."""
    ray = Ray()
    ray.x = float(p[0])
    ray.back = wp.where(back, 1, 0)
    y = float(p[1])
    z = float(p[2])
    room_y = RAY_ROOM + RAY_ROOM * wp.abs(y)
    room_z = RAY_ROOM + RAY_ROOM * wp.abs(z)
    ray.low_y = y - room_y
    ray.high_y = y + room_y
    ray.low_z = z - room_z
    ray.high_z = z + room_z
    return ray


@wp.func
def meets_ray(tree: Tree, node: int, ray: Ray):
    """True if a ray can meet something in a node's box."""
    low, high = node_box(tree, node)
    ahead = wp.where(ray.back != 0, low[0] <= ray.x, high[0] > ray.x)
    return ahead and low[1] <= ray.high_y and high[1] >= ray.low_y and low[2] <= ray.high_z and high[2] >= ray.low_z


@wp.func
def count_on_ray(tree: Tree, mesh: int, p: wp.vec3d, back: bool):
    """Signed crossings beyond p along +x; or of those at p and along -x, turned round.

    Of a closed mesh they are equal, as the crossings of a whole line add up to zero.
    """
    base = nodes_of(tree, mesh)
    leaves = 1 << tree.depth
    q = to_lattice(tree, mesh, p[1], p[2])
    ray = ray_from(p, back)
    total = int(0)
    nodes = NodeStack()
    waiting = int(0)
    node = wp.where(meets_ray(tree, base + 1, ray), 1, 0)
    while node > 0:
        if node >= leaves:
            leaf = node - leaves
            end = first_triangle(tree, leaf + 1)
            for t in range(first_triangle(tree, leaf), end):
                slot = slots_of(tree, mesh) + t
                total = total + crossing_on_ray(tree, slot, q, p[0], back)
            node = int(0)
        else:
            left = 2 * node
            right = left + 1
            hit_left = meets_ray(tree, base + left, ray)
            hit_right = meets_ray(tree, base + right, ray)
            node = wp.where(hit_left, left, wp.where(hit_right, right, 0))
            if hit_left and hit_right:
                nodes[waiting] = right
                waiting = waiting + 1
        if node == 0 and waiting > 0:
            waiting = waiting - 1
            node = nodes[waiting]
    return wp.where(back, -total, total)


@wp.func
def count_crossings(tree: Tree, mesh: int, p: wp.vec3d):
    """Signed crossings of the ray from p (scaled) along +x: the winding number at p if the mesh is closed."""
    return count_on_ray(tree, mesh, p, False)


@wp.func
def winding_of_closed(tree: Tree, mesh: int, p: wp.vec3d):
    """The winding number of a closed mesh at p (scaled), by whichever ray along x leaves its box sooner."""
    low, high = node_box(tree, nodes_of(tree, mesh) + 1)
    return count_on_ray(tree, mesh, p, wp.float64(low[0] + high[0]) > wp.float64(2.0) * p[0])
