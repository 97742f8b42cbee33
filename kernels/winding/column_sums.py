"""Winding numbers at every voxel of a slab.

Closed and nearly closed meshes are scan converted: every triangle marks where it crosses the columns of voxels along
x (see `scan_convert`), and a sum along each column turns crossings into winding numbers, exactly (see `ray_crossings`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.voxel_grid import Slab, unravel, voxel
from sdm.kernels.launch import launch
from sdm.kernels.winding.boundary_term import boundary_winding
from sdm.kernels.winding.dipole_tree import soup_winding
from sdm.kernels.winding.open_caps import open_caps
from sdm.kernels.winding.ray_crossings import count_crossings
from sdm.kernels.winding.scan_convert import scan_triangles
from sdm.kernels.winding.winding_number import CLOSED, SOUP, Winding

wp.set_module_options({"enable_backward": False})

# Voxels of a column that are loaded at a time.
AHEAD = 8

Ahead = wp.types.vector(length=AHEAD, dtype=wp.int32)


@wp.kernel
def _sum_columns(begin: int, slab: Slab, counts: wp.array4d(dtype=wp.int32), values: wp.array4d(dtype=wp.float32)):
    """From crossings to winding numbers, in the same memory: a voxel sees every crossing at or beyond it."""
    i = begin + wp.tid()
    columns = slab.shape[1] * slab.shape[2]
    mesh = i / columns
    j = (i - mesh * columns) / slab.shape[2]
    k = i % slab.shape[2]
    total = int(0)
    end = slab.shape[0]
    while end >= AHEAD:
        # All loads before any store, which each would wait for.
        ahead = Ahead()
        for back in range(AHEAD):
            ahead[back] = counts[mesh, end - 1 - back, j, k]
        for back in range(AHEAD):
            total = total + ahead[back]
            values[mesh, end - 1 - back, j, k] = float(total)
        end = end - AHEAD
    while end > 0:
        end = end - 1
        total = total + counts[mesh, end, j, k]
        values[mesh, end, j, k] = float(total)


@wp.func
def numbered_voxel(tree: Tree, slab: Slab, number: int):
    """The mesh and the indices of a voxel of a batch, counted with k fastest, and its centre (scaled)."""
    mesh, at = unravel(number, slab.shape)
    p = tree.frame[mesh * FRAME_SIZE + SCALE] * wp.vec3d(voxel(slab, at[0], at[1], at[2]))
    return mesh, at[0], at[1], at[2], p


@wp.kernel
def _count_at_voxels(
    begin: int, tree: Tree, caps: Tree, with_caps: int, slab: Slab, values: wp.array4d(dtype=wp.float32)
):
    """One ray for every voxel: for turned grids, whose columns are not along x."""
    mesh, i, j, k, p = numbered_voxel(tree, slab, begin + wp.tid())
    found = count_crossings(tree, mesh, p)
    if with_caps != 0:
        found = found + count_crossings(caps, mesh, p)
    values[mesh, i, j, k] = float(found)


@wp.kernel
def _add_boundary(begin: int, tree: Tree, winding: Winding, slab: Slab, values: wp.array4d(dtype=wp.float32)):
    mesh, i, j, k, p = numbered_voxel(tree, slab, begin + wp.tid())
    share = float(0.0)
    if winding.kind == SOUP:
        share = float(soup_winding(tree, winding.moments, mesh, p))
    else:
        share = float(boundary_winding(winding.boundary, tree, mesh, p))
    values[mesh, i, j, k] = values[mesh, i, j, k] + share


# "caps" for the fast way of open meshes, "edges" for the sum over all boundary edges at each voxel: tests compare them.
OPEN_METHOD = "caps"


def slab_winding(
    tree: Tree,
    winding: Winding,
    slab: Slab,
    values: wp.array,
    empty: Callable[[int, Any], wp.array],
    most_columns: int | None = None,
) -> None:
    """Winding numbers of each mesh at each voxel of a slab, for its sign.

    Fills `values` (meshes, n, ny, nz) float32. Where an open mesh's winding number is within a quarter of a whole
    number, it may be that number instead. `empty(length, dtype)` allocates scratch; for `most_columns` see
    `PlanOptions`.
    """
    device = values.device
    meshes, nx, ny, nz = values.shape
    total = meshes * nx * ny * nz
    # Caps close the holes, and are opened again.
    with_caps = winding.kind not in (CLOSED, SOUP) and OPEN_METHOD == "caps"
    if winding.kind == SOUP:
        values.zero_()
    elif slab.turned != 0:
        launch(_count_at_voxels, total, [tree, winding.caps.tree, int(with_caps), slab, values], device)
    else:
        values.zero_()
        counts = values.view(wp.int32)
        flat = counts.flatten()
        scan_triangles(tree, slab, flat, meshes, empty, most_columns)
        if with_caps:
            scan_triangles(winding.caps.tree, slab, flat, meshes, empty, most_columns)
        launch(_sum_columns, meshes * ny * nz, [slab, counts, values], device)
    if with_caps:
        open_caps(tree, winding.boundary, winding.caps, slab, values, empty)
    elif winding.kind != CLOSED:
        launch(_add_boundary, total, [tree, winding, slab, values], device)
