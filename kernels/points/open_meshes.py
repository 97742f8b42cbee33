"""Winding data of open meshes that differ: each of its own kind, with edges, caps and dipoles where that has them.

All meshes' edges are in one row, and so are their caps' trees and their dipoles. What points of one mesh look at is
that of a single mesh, by arrays that begin at its own: functions that know of one mesh serve as they are, and are told
that it is mesh 0.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import BOX_FLOATS, FRAME_SIZE, SCALE, Tree, to_lattice, tree_of
from sdm.kernels.launch import launch
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.dipole_tree import MOMENTS_SIZE, join_halves, make_leaf
from sdm.kernels.winding.winding_number import Winding

wp.set_module_options({"enable_backward": False})

# Entries of a mesh's row: its kind, its first edge and how many it has, both as far as they are visited, the number of
# its tree among those of caps, the first node of its dipoles, and the first of its edges' rows of sixteen.
KIND, FIRST_EDGE, EDGES, CAPS, DIPOLES, SIXTEENS, ROW = 0, 1, 2, 3, 4, 5, 6


@wp.struct
class OpenMeshes:
    """Winding data of meshes that differ, by their numbers in the hierarchy of all."""

    rows: wp.array(dtype=wp.int32)  # (meshes * ROW)
    ends: wp.array(dtype=wp.vec3)  # (2 * edges) as those of `Boundary`
    lattice: wp.array(dtype=wp.vec2i)  # (2 * edges)
    caps: Tree  # of meshes that differ: those whose edges are visited
    moments: wp.array(dtype=wp.float32)  # (nodes * MOMENTS_SIZE) of the dipoles


@wp.func
def by_itself(tree: Tree, mesh: int):
    """The hierarchy of one mesh of those that differ, as the only one: mesh 0 of arrays that begin with its own."""
    one = tree_of(tree, mesh)
    one.corners = tree.corners[4 * one.first :]
    one.lattice = tree.lattice[3 * one.first :]
    one.boxes = tree.boxes[BOX_FLOATS * one.root :]
    one.frame = tree.frame[FRAME_SIZE * mesh :]
    one.first = 0
    one.root = 0
    return one


@wp.func
def winding_of(meshes: OpenMeshes, mesh: int):
    """The data of one mesh, as those of the only one."""
    row = ROW * mesh
    first = 2 * meshes.rows[row + FIRST_EDGE]
    boundary = Boundary()
    boundary.count = meshes.rows[row + EDGES]
    boundary.ends = meshes.ends[first:]
    boundary.lattice = meshes.lattice[first:]
    winding = Winding()
    winding.kind = meshes.rows[row + KIND]
    winding.boundary = boundary
    winding.caps.tree = by_itself(meshes.caps, meshes.rows[row + CAPS])
    winding.moments = meshes.moments[MOMENTS_SIZE * meshes.rows[row + DIPOLES] :]
    return winding


@wp.kernel
def _gather_edges(
    begin: int,
    tree: Tree,
    vertices: wp.array(dtype=wp.vec3),
    edges: wp.array2d(dtype=wp.int32),
    owners: wp.array(dtype=wp.int32),
    out: OpenMeshes,
):
    i = begin + wp.tid()
    mesh = owners[i]
    scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
    for end in range(2):
        v = scale * vertices[edges[i, end]]
        out.ends[2 * i + end] = v
        out.lattice[2 * i + end] = to_lattice(tree, mesh, wp.float64(v[1]), wp.float64(v[2]))


def gather_edges(tree: Tree, vertices: wp.array, edges: wp.array, owners: wp.array, out: OpenMeshes) -> None:
    """Fill ends and lattice of `out`.

    Args:
        tree: The hierarchy of all meshes.
        vertices: (V,) vec3, of all meshes in a row.
        edges: (E,2) int32, boundary edges by the numbers of their vertices among these, mesh by mesh.
        owners: (E,) int32, the mesh of each.
        out: What to fill.
    """
    launch(_gather_edges, edges.shape[0], [tree, vertices, edges, owners, out], vertices.device)


@wp.kernel
def _leaf_moments(begin: int, tree: Tree, meshes: OpenMeshes, which: wp.array(dtype=wp.int32), depth: int):
    i = begin + wp.tid()
    number = i >> depth
    leaf = i - (number << depth)
    mesh = which[number]
    one = by_itself(tree, mesh)
    if leaf < 1 << one.depth:
        make_leaf(one, 0, leaf, meshes.moments[MOMENTS_SIZE * meshes.rows[ROW * mesh + DIPOLES] :])


@wp.kernel
def _level_moments(begin: int, tree: Tree, meshes: OpenMeshes, which: wp.array(dtype=wp.int32), level: int):
    i = begin + wp.tid()
    number = i >> level
    mesh = which[number]
    one = by_itself(tree, mesh)
    if level < one.depth:
        node = (1 << level) + i - (number << level)
        join_halves(one, 0, node, meshes.moments[MOMENTS_SIZE * meshes.rows[ROW * mesh + DIPOLES] :])


def build_dipoles(tree: Tree, meshes: OpenMeshes, which: wp.array, depth: int) -> None:
    """Fill the moments of some meshes, (n,) int32, whose hierarchies have up to so many levels."""
    count, device = which.shape[0], which.device
    launch(_leaf_moments, count << depth, [tree, meshes, which, depth], device)
    for level in range(depth - 1, -1, -1):
        launch(_level_moments, count << level, [tree, meshes, which, level], device)
