"""The generalised winding number of any triangle soup, with a bound on its error: a tree of dipoles.

The solid angle of the triangles under a node, seen from p, is expanded about the node's centre to the first order
beyond the dipole (Barill et al. 2018). The gradient of the Legendre term of degree l is at most l r^(l-1) / R^(l+1)
(Bernstein and Szego), so with rho = r/R the rest is at most area / R^2 * (1 / (1 - rho)^2 - 1 - 2 rho): a bound,
not an estimate. The descent opens nodes until the sum of all bounds cannot change the answer. Triangles that it
reaches are evaluated in float64.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import NodeStack
from sdm.kernels.bvh.tree import Tree, first_triangle, node_box, nodes_of
from sdm.kernels.geometry.triangle_distance import solid_angle
from sdm.kernels.launch import launch

wp.set_module_options({"enable_backward": False})

# A node's moments: centre (3), radius, area, area vector (3), first moment (9).
MOMENTS_SIZE = 17
_SIZE = MOMENTS_SIZE
# The winding number is known at least this well where it is close to a threshold.
FINEST = wp.float64(4.0e-4)
# Further away than this many sizes of a mesh its winding number is zero, and float32 runs out of range.
FARTHEST = wp.float64(1.0e12)


@wp.func
def write_moments(
    moments: wp.array(dtype=wp.float32),
    tree: Tree,
    node: int,
    centre: wp.vec3d,
    area: wp.float64,
    vector: wp.vec3d,
    first: wp.mat33d,
):
    low, high = node_box(tree, node)
    at = node * _SIZE
    # The radius is taken about the centre as stored, so that rounding cannot make it too small.
    c = wp.vec3(centre)
    reach = wp.max(wp.vec3d(c) - wp.vec3d(low), wp.vec3d(high) - wp.vec3d(c))
    for i in range(3):
        moments[at + i] = c[i]
        moments[at + 5 + i] = float(vector[i])
        for j in range(3):
            moments[at + 8 + 3 * i + j] = float(first[i, j])
    moments[at + 3] = float(wp.length(reach) * wp.float64(1.000001))
    moments[at + 4] = float(area)


@wp.func
def make_leaf(tree: Tree, mesh: int, leaf: int, moments: wp.array(dtype=wp.float32)):
    """Write the moments of a leaf from its triangles."""
    leaves = 1 << tree.depth
    third = wp.float64(1.0) / wp.float64(3.0)
    half = wp.float64(0.5)
    area = wp.float64(0.0)
    weighted = wp.vec3d()
    vector = wp.vec3d()
    start = mesh * tree.count + first_triangle(tree, leaf)
    end = mesh * tree.count + first_triangle(tree, leaf + 1)
    node = nodes_of(tree, mesh) + leaves + leaf
    for slot in range(start, end):
        a = wp.vec3d(tree.corners[4 * slot])
        b = wp.vec3d(tree.corners[4 * slot + 1])
        c = wp.vec3d(tree.corners[4 * slot + 2])
        n = half * wp.cross(b - a, c - a)
        size = wp.length(n)
        area = area + size
        weighted = weighted + size * third * (a + b + c)
        vector = vector + n
    low, high = node_box(tree, node)
    centre = half * (wp.vec3d(low) + wp.vec3d(high))
    if area > wp.float64(0.0):
        centre = weighted / area
    centre = wp.vec3d(wp.vec3(centre))
    first = wp.mat33d()
    for slot in range(start, end):
        a = wp.vec3d(tree.corners[4 * slot])
        b = wp.vec3d(tree.corners[4 * slot + 1])
        c = wp.vec3d(tree.corners[4 * slot + 2])
        n = half * wp.cross(b - a, c - a)
        first = first + wp.outer(third * (a + b + c) - centre, n)
    write_moments(moments, tree, node, centre, area, vector, first)


@wp.kernel
def _leaf_moments(begin: int, tree: Tree, moments: wp.array(dtype=wp.float32)):
    i = begin + wp.tid()
    leaves = 1 << tree.depth
    mesh = i / leaves
    make_leaf(tree, mesh, i - mesh * leaves, moments)


@wp.func
def read_vector(moments: wp.array(dtype=wp.float32), at: int):
    return wp.vec3(moments[at], moments[at + 1], moments[at + 2])


@wp.func
def read_matrix(moments: wp.array(dtype=wp.float32), at: int):
    return wp.matrix_from_rows(read_vector(moments, at), read_vector(moments, at + 3), read_vector(moments, at + 6))


@wp.func
def join_halves(tree: Tree, mesh: int, number: int, moments: wp.array(dtype=wp.float32)):
    """Write the moments of a node with this number in its mesh from those of its children."""
    base = nodes_of(tree, mesh)
    node = base + number
    left = (base + 2 * (node - base)) * _SIZE
    right = left + _SIZE
    area_l = wp.float64(moments[left + 4])
    area_r = wp.float64(moments[right + 4])
    centre_l = wp.vec3d(read_vector(moments, left))
    centre_r = wp.vec3d(read_vector(moments, right))
    vector_l = wp.vec3d(read_vector(moments, left + 5))
    vector_r = wp.vec3d(read_vector(moments, right + 5))
    area = area_l + area_r
    low, high = node_box(tree, node)
    centre = wp.float64(0.5) * (wp.vec3d(low) + wp.vec3d(high))
    if area > wp.float64(0.0):
        centre = (area_l * centre_l + area_r * centre_r) / area
    centre = wp.vec3d(wp.vec3(centre))
    first = (
        wp.mat33d(read_matrix(moments, left + 8))
        + wp.mat33d(read_matrix(moments, right + 8))
        + wp.outer(centre_l - centre, vector_l)
        + wp.outer(centre_r - centre, vector_r)
    )
    write_moments(moments, tree, node, centre, area, vector_l + vector_r, first)


@wp.kernel
def _level_moments(begin: int, tree: Tree, moments: wp.array(dtype=wp.float32), width: int):
    i = begin + wp.tid()
    mesh = i / width
    join_halves(tree, mesh, width + i - mesh * width, moments)


def build_moments(tree: Tree, moments: wp.array, meshes: int) -> None:
    """Fill `moments` (meshes * 2^(depth+1) * MOMENTS_SIZE float32) from a built tree."""
    launch(_leaf_moments, meshes << tree.depth, [tree, moments], moments.device)
    for level in range(tree.depth - 1, -1, -1):
        launch(_level_moments, meshes << level, [tree, moments, 1 << level], moments.device)


@wp.func
def descend(tree: Tree, moments: wp.array(dtype=wp.float32), mesh: int, p: wp.vec3d, tolerance: float):
    """Winding number at p and a bound on its error, opening every node whose own bound is above `tolerance`."""
    base = nodes_of(tree, mesh)
    leaves = 1 << tree.depth
    quarter = float(1.0) / (4.0 * wp.PI)
    p32 = wp.vec3(p)
    winding = wp.float64(0.0)
    error = float(0.0)
    nodes = NodeStack()
    waiting = int(0)
    node = int(1)
    while node > 0:
        at = (base + node) * _SIZE
        q = read_vector(moments, at) - p32
        distance2 = wp.dot(q, q)
        distance = wp.sqrt(distance2)
        radius = moments[at + 3]
        bound = float(wp.inf)
        if radius < 0.9 * distance:
            rho = radius / distance
            rest = 1.0 - rho
            # 1/(1-rho)^2 - 1 - 2 rho without cancellation.
            bound = quarter * moments[at + 4] / distance2 * rho * rho * (3.0 - 2.0 * rho) / (rest * rest)
        if bound <= tolerance:
            inverse = 1.0 / distance
            inverse3 = inverse * inverse * inverse
            first = read_matrix(moments, at + 8)
            value = wp.dot(read_vector(moments, at + 5), q) + wp.trace(first)
            value = value - 3.0 * wp.dot(q, first * q) * inverse * inverse
            winding = winding + wp.float64(quarter * value * inverse3)
            error = error + bound
            node = int(0)
        elif node >= leaves:
            leaf = node - leaves
            end = first_triangle(tree, leaf + 1)
            for t in range(first_triangle(tree, leaf), end):
                slot = mesh * tree.count + t
                a = wp.vec3d(tree.corners[4 * slot]) - p
                b = wp.vec3d(tree.corners[4 * slot + 1]) - p
                c = wp.vec3d(tree.corners[4 * slot + 2]) - p
                winding = winding + solid_angle(a, b, c) * wp.float64(quarter)
            node = int(0)
        else:
            nodes[waiting] = 2 * node + 1
            waiting = waiting + 1
            node = 2 * node
        if node == 0 and waiting > 0:
            waiting = waiting - 1
            node = nodes[waiting]
    return winding, wp.float64(error)


@wp.func
def soup_winding(tree: Tree, moments: wp.array(dtype=wp.float32), mesh: int, p: wp.vec3d):
    """The winding number at p (scaled): on the right side of 0.25, 0.5 and 0.75, to within `FINEST` of them."""
    half = wp.float64(0.5)
    quarter = wp.float64(0.25)
    if wp.length(p) > FARTHEST:
        return wp.float64(0.0)
    tolerance = float(2.0e-3)
    winding = wp.float64(0.0)
    settled = int(0)
    rounds = int(0)
    while settled == 0 and rounds < 12:
        rounds = rounds + 1
        estimate, error = descend(tree, moments, mesh, p, tolerance)
        winding = estimate
        margin = wp.abs(estimate - half)
        margin = wp.min(margin, wp.abs(margin - quarter))
        needed = wp.max(FINEST, margin)
        if error <= needed:
            settled = int(1)
        else:
            tolerance = tolerance * wp.clamp(0.5 * float(needed / error), 0.02, 0.5)
    return winding
