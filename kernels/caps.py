"""Where an open mesh's boundary matters: only near its holes.

Every loop of boundary edges gets a cap: a fan of triangles from its middle. Surface and caps together are closed, so
their crossings count a whole number, and the surface's own winding number is that number less the caps' share, which
is their solid angle over 4 pi. A triangle of area A at a distance d or more fills at most A/d^2. Where the sum over
all caps leaves no doubt for a whole cell of voxels (the winding number is within a quarter of a whole number), the
number is rounded to it; sign and clearness are the same. Elsewhere it is worked out (see `boundary`).
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.boundary import Boundary
from sdm.kernels.crossings import covers, crossing_of
from sdm.kernels.cull import Cell
from sdm.kernels.geometry import nearest_part
from sdm.kernels.tree import Tree, to_lattice

wp.set_module_options({"enable_backward": False})

# Less than a quarter, by more than the rounding of the sum.
LARGEST_SHARE = wp.constant(0.249)


@wp.func
def cap_lattice(boundary: Boundary, tree: Tree, edge: int, mesh: int):
    """The (y,z) of a cap's triangle on the lattice: the edge backwards, then its apex."""
    apex = boundary.apexes[edge]
    top = to_lattice(tree, mesh, wp.float64(apex[1]), wp.float64(apex[2]))
    return boundary.lattice[2 * edge + 1], boundary.lattice[2 * edge], top


@wp.func
def count_caps(boundary: Boundary, tree: Tree, mesh: int, p: wp.vec3d):
    """Signed crossings of the ray from p (scaled) along +x with all caps."""
    q = to_lattice(tree, mesh, p[1], p[2])
    total = int(0)
    for e in range(boundary.count):
        edge = mesh * boundary.count + e
        a, b, c = cap_lattice(boundary, tree, edge, mesh)
        sign = covers(a, b, c, q)
        if sign != 0:
            x = crossing_of(
                a, b, c, boundary.ends[2 * edge + 1][0], boundary.ends[2 * edge][0], boundary.apexes[edge][0], q
            )
            if x > p[0]:
                total = total + sign
    return total


@wp.func
def caps_are_far(boundary: Boundary, mesh: int, cell: Cell):
    """Whether the caps' share of the winding number is less than a quarter at every voxel of a cell."""
    radius = wp.sqrt(cell.half2)
    share = float(0.0)
    e = int(0)
    while e < boundary.count and share < LARGEST_SHARE:
        edge = mesh * boundary.count + e
        a = boundary.ends[2 * edge]
        b = boundary.ends[2 * edge + 1]
        c = boundary.apexes[edge]
        across = wp.cross(b - a, c - a)
        area2 = wp.length(across)
        if area2 > 0.0:
            across = across / area2
        d2, _part = nearest_part(cell.centre, a, b, c, across)
        # A percent for rounding, which can take a thin triangle's plane for its edge.
        gap = 0.99 * wp.sqrt(d2) - radius
        if gap <= 0.0:
            share = 1.0
        else:
            share = share + area2 / (8.0 * wp.PI * gap * gap)
        e = e + 1
    return share < LARGEST_SHARE
