"""Boundary term: what an open mesh's boundary adds to the count of crossings, exactly.

Sweep each boundary edge to infinity along -x. Surface and swept strips together are closed, and the ray along +x
never meets a strip, so the crossings count the winding number of both; the surface's own is that count less the
strips' solid angles (the idea of the Antipodal Method, arXiv 2605.01536). A strip's solid angle is that of the
triangle of its edge and the direction -x. Where the ray passes an edge, the count jumps and a strip's solid angle
jumps back: both take the side from the same integer test, so their sum does not.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import (
    COUNT,
    DEPTH,
    FIRST,
    FRAME_SIZE,
    LATTICE,
    LATTICE_STEPS,
    LOW_X,
    PART_SIZE,
    ROOT,
    SCALE,
    Tree,
    to_lattice,
)
from sdm.kernels.launch import launch
from sdm.kernels.winding.ray_crossings import is_left

wp.set_module_options({"enable_backward": False})

# Rays further off than this are not on the lattice: `to_lattice` stops there.
LATTICE_LIMIT = wp.float64(2.0) * LATTICE_STEPS
# How `is_left` breaks ties, in steps of the lattice (its epsilon, squared and plain; any small number will do).
TIE_ROW = wp.float64(1.0e-20)
TIE_COLUMN = wp.float64(1.0e-10)
TINY = wp.float64(1.0e-300)


@wp.struct
class Boundary:
    """Directed boundary edges of each mesh of a batch, the surface on their left; an edge met twice stands twice."""

    ends: wp.array(dtype=wp.vec3)  # (2 * meshes * count) first and last point, scaled
    lattice: wp.array(dtype=wp.vec2i)  # (2 * meshes * count) their (y,z) on the lattice
    count: wp.int32  # edges of each mesh
    in_room: wp.int32  # 1 if `count` is room for those of the only mesh, of which there are:
    counted: wp.array(dtype=wp.int32)  # (1) so many
    parts: wp.array(dtype=wp.int32)  # (2 * PART_SIZE) then, those of the tree of caps


@wp.func
def edges_of(boundary: Boundary):
    """Edges of each mesh."""
    count = boundary.count
    if boundary.in_room != 0:
        found = boundary.counted[0]
        # If there are more they have no room, and nobody wants what comes of it.
        count = wp.where(found <= count, found, 0)
    return count


@wp.func
def write_parts(parts: wp.array(dtype=wp.int32), count: int, room: int):
    """Write the parts of a tree of so many caps, which has a leaf for each, and of one of those behind them, up to a
    room: there is always one, and its tree is of that alone, as nobody looks for any.
    """
    depth = int(0)
    while (1 << depth) < count:
        depth = depth + 1
    parts[COUNT] = count
    parts[DEPTH] = depth
    most = int(0)
    while (1 << most) < room:
        most = most + 1
    parts[PART_SIZE + FIRST] = count
    parts[PART_SIZE + COUNT] = 1
    parts[PART_SIZE + DEPTH] = 0
    parts[PART_SIZE + ROOT] = 2 << most


@wp.kernel
def _gather(
    begin: int, vertices: wp.array2d(dtype=wp.vec3), edges: wp.array2d(dtype=wp.int32), tree: Tree, out: Boundary
):
    i = begin + wp.tid()
    if i == 0 and out.in_room != 0:
        write_parts(out.parts, edges_of(out), out.count + 1)
    mesh = i / out.count
    e = i - mesh * out.count
    scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
    for end in range(2):
        v = scale * vertices[mesh, edges[e, end]]
        out.ends[2 * i + end] = v
        out.lattice[2 * i + end] = to_lattice(tree, mesh, wp.float64(v[1]), wp.float64(v[2]))


def gather_boundary(out: Boundary, tree: Tree, vertices: wp.array, edges: wp.array) -> None:
    """Fill `out` from the meshes' `vertices` (meshes, V) and their shared boundary `edges` (E, 2).

    Where those are in room, also the parts of the tree of caps, which have room for one more.
    """
    launch(_gather, vertices.shape[0] * edges.shape[0], [vertices, edges, tree, out], vertices.device)


@wp.kernel
def _write_parts(begin: int, counts: wp.array(dtype=wp.int32), place: int, room: int, parts: wp.array(dtype=wp.int32)):
    write_parts(parts, counts[place], room)


def write_parts_of_faces(counts: wp.array, place: int, room: int, parts: wp.array) -> None:
    """Fill `parts` (2 * PART_SIZE) int32, zeros, of a tree of caps that are faces: so many as `counts` say at a place,
    with others behind them up to a room.
    """
    launch(_write_parts, 1, [counts, place, room, parts], parts.device)


@wp.func
def strip_side(ahead: wp.float64, aside2: wp.float64, length: wp.float64):
    """length - ahead for a vector of that length, `ahead` along +x and the rest of squared length `aside2`."""
    if ahead > wp.float64(0.0):
        return aside2 / (length + ahead)
    return length - ahead


@wp.func
def strip_factor(
    boundary: Boundary,
    e: int,
    p: wp.vec3d,
    q: wp.vec2i,
    row: wp.float64,
    column: wp.float64,
    step: wp.float64,
    on_lattice: bool,
):
    """A complex number (x, y) of size 0.7 to 1, whose argument is half the solid angle of an edge's strip from p."""
    first = boundary.lattice[2 * e]
    second = boundary.lattice[2 * e + 1]
    a = wp.vec3d(
        wp.float64(boundary.ends[2 * e][0]) - p[0],
        step * (wp.float64(first[0]) - row + TIE_ROW),
        step * (wp.float64(first[1]) - column - TIE_COLUMN),
    )
    b = wp.vec3d(
        wp.float64(boundary.ends[2 * e + 1][0]) - p[0],
        step * (wp.float64(second[0]) - row + TIE_ROW),
        step * (wp.float64(second[1]) - column - TIE_COLUMN),
    )
    across = a[1] * b[2] - a[2] * b[1]
    left = across > wp.float64(0.0)
    if on_lattice:
        left = is_left(first, second, q)
    aside_a = a[1] * a[1] + a[2] * a[2]
    aside_b = b[1] * b[1] + b[2] * b[2]
    la = wp.sqrt(a[0] * a[0] + aside_a)
    lb = wp.sqrt(b[0] * b[0] + aside_b)
    x = strip_side(a[0], aside_a, la) * strip_side(b[0], aside_b, lb) + a[1] * b[1] + a[2] * b[2]
    y = wp.abs(across) + TINY
    size = wp.float64(1.0) / (wp.abs(x) + y)
    return x * size, wp.where(left, -y * size, y * size)


@wp.func
def turn_of(before: wp.float64, y: wp.float64, after: wp.float64):
    """Whole turns that a factor adds to an argument, by its imaginary part and the product's before and after."""
    zero = wp.float64(0.0)
    turns = int(0)
    if before >= zero and y > zero and after < zero:
        turns = 1
    if before < zero and y < zero and after >= zero:
        turns = -1
    return turns


@wp.func
def boundary_part(boundary: Boundary, tree: Tree, mesh: int, p: wp.vec3d, lane: int, lanes: int):
    """A lane's part of the boundary's share of the winding number at p (scaled).

    (y,z) of ray and edges are those on the lattice, so that the angles agree with the sides even where the ray passes
    a corner and both strips that meet there turn with it. That moves the boundary by a step of the lattice at most.
    """
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    base = mesh * FRAME_SIZE
    steps = tree.frame[base + LATTICE]
    step = one
    if steps > zero:
        step = one / steps
    q = to_lattice(tree, mesh, p[1], p[2])
    row = wp.floor((p[1] - tree.frame[base + LOW_X + 1]) * steps)
    column = wp.floor((p[2] - tree.frame[base + LOW_X + 2]) * steps)
    on_lattice = wp.max(wp.abs(row), wp.abs(column)) < LATTICE_LIMIT
    # The sum of all half solid angles is the argument of a product of complex numbers and a count of its full turns.
    re = one
    im = zero
    turns = int(0)
    count = edges_of(boundary)
    base_of_edges = mesh * boundary.count
    taken = int(0)
    e = lane
    while e < count:
        # Two at a time: a GPU waits long for one's roots and quotients.
        other = wp.min(e + lanes, count - 1)
        x, y = strip_factor(boundary, base_of_edges + e, p, q, row, column, step, on_lattice)
        u, v = strip_factor(boundary, base_of_edges + other, p, q, row, column, step, on_lattice)
        if e + lanes >= count:
            u = one
            v = zero
        new_re = re * x - im * y
        new_im = re * y + im * x
        turns = turns + turn_of(im, y, new_im)
        re = new_re * u - new_im * v
        im = new_re * v + new_im * u
        turns = turns + turn_of(new_im, v, im)
        # Each factor is between 0.7 and 1.
        taken = taken + 1
        if taken == 8:
            taken = int(0)
            size = one / (wp.abs(re) + wp.abs(im) + TINY)
            re = re * size
            im = im * size
        e = e + 2 * lanes
    pi = wp.float64(wp.PI)
    return (wp.atan2(im, re) + wp.float64(2.0) * pi * wp.float64(turns)) / (wp.float64(2.0) * pi)


@wp.func
def boundary_winding(boundary: Boundary, tree: Tree, mesh: int, p: wp.vec3d):
    """The boundary's share of the winding number at p (scaled): add it to the count of crossings."""
    return boundary_part(boundary, tree, mesh, p, 0, 1)
