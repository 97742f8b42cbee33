"""Winding number at a point, found in a way that the kind of mesh decides."""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree
from sdm.kernels.winding.boundary_term import Boundary, boundary_winding
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.dipole_tree import soup_winding
from sdm.kernels.winding.ray_crossings import count_crossings, winding_of_closed

wp.set_module_options({"enable_backward": False})


@wp.struct
class Winding:
    """Data to find winding numbers by; the kind of mesh decides how."""

    boundary: Boundary  # used if kind is OPEN, MANY or DIRTY
    caps: Caps  # the same
    moments: wp.array(dtype=wp.float32)  # used if kind is MANY, DIRTY or SOUP
    kind: wp.int32


# Without a boundary; with few boundary edges, all of which are visited for a point; with many, which are visited where
# a group of points shares the cost; with more, which are visited for single voxels of a map in doubt; with so many
# that only the tree of dipoles is used; and of points whose side nobody asks for, no data at all.
CLOSED, OPEN, MANY, DIRTY, SOUP, UNSIGNED = 0, 1, 2, 3, 4, 5


@wp.func
def winding_at(tree: Tree, winding: Winding, mesh: int, p: wp.vec3d):
    """The generalised winding number at p (scaled)."""
    if winding.kind == CLOSED:
        return float(winding_of_closed(tree, mesh, p))
    if winding.kind == OPEN:
        return float(wp.float64(count_crossings(tree, mesh, p)) + boundary_winding(winding.boundary, tree, mesh, p))
    return float(soup_winding(tree, winding.moments, mesh, p))


@wp.func
def inside_at(tree: Tree, winding: Winding, p: wp.vec3d, far: bool, covered: bool):
    """True if the winding number at p (scaled) is more than 0.5.

    Args:
        tree: One mesh's hierarchy.
        winding: How its winding number is found.
        p: The point.
        far: Whether the holes of an open mesh are so far away that it has the same sides with its holes closed.
        covered: Whether the line through p along x may meet what closes them.
    """
    if far and covered:
        return count_crossings(tree, 0, p) + count_crossings(winding.caps.tree, 0, p) > 0
    if far:
        return winding_of_closed(tree, 0, p) > 0
    return winding_at(tree, winding, 0, p) > 0.5
