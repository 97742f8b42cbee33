"""Winding numbers at every voxel of a slab.

Closed and nearly closed meshes are scan converted: every triangle marks where it crosses the columns of voxels along
x (see `scan_convert`), and a sum along each column turns crossings into winding numbers, exactly (see `ray_crossings`).
Most triangles lie under few columns, and are the work of one thread or a few; those that lie under many are put aside
and shared out, as the others would wait for them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree, tree_of
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, start_of_mesh, unravel, voxel, voxel_at
from sdm.kernels.launch import launch, new_zeros, threads
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, GPU_LANES, gpu_workers
from sdm.kernels.winding.boundary_term import boundary_winding
from sdm.kernels.winding.columns.packed_crossings import (
    Crossings,
    can_be_packed,
    count_full,
    new_packed,
    sum_packed,
)
from sdm.kernels.winding.dipole_tree import soup_winding
from sdm.kernels.winding.eights.boxes_by_caps import open_caps_by_eights
from sdm.kernels.winding.eights.boxes_by_edges import open_edges_by_eights
from sdm.kernels.winding.open_caps import open_caps
from sdm.kernels.winding.ray_crossings import count_crossings
from sdm.kernels.winding.rims.edge_boxes import FACES_AN_EDGE, MOST_EDGES, open_edges
from sdm.kernels.winding.rims.every_voxel import MOST_SUMS, add_rims
from sdm.kernels.winding.scan_convert import mark_triangle
from sdm.kernels.winding.winding_number import CLOSED, SOUP, Winding

wp.set_module_options({"enable_backward": False})

# Columns for each lane from which on a triangle is shared out to many groups of lanes, into so many pieces: where most
# triangles are small, the others would wait for one that lies under half of the grid.
ANY = 1 << 30
MOST_COLUMNS = {"cuda": 16, "cpu": ANY}
PIECES = 64
# Threads of a launch that are enough to choose by: far below what is counted with 32 bits.
MOST_THREADS = 1 << 26
# Two, as Warp takes a constant that a kernel has cast for the cast one from there on.
_PIECES_64 = wp.int64(PIECES)
# Voxels of a column that are loaded at a time.
AHEAD = 8

Ahead = wp.types.vector(length=AHEAD, dtype=wp.int32)


@wp.kernel
def _scan_convert(
    begin: int,
    tree: Tree,
    slab: Slab,
    lanes: int,
    most: int,
    counts: wp.array(dtype=wp.int32),
    full: wp.array(dtype=wp.int32),
    packed: int,
    large: wp.array(dtype=wp.vec2i),
    larges: wp.array(dtype=wp.int32),
):
    """Mark the columns of triangles that have few; note the slot and number of columns of those with `most` a lane."""
    thread = begin + wp.tid()
    slot = thread / lanes
    lane = thread % lanes
    columns = mark_triangle(tree, slab, counts, full, packed, slot, most, lane, lanes)
    if columns / lanes >= most and lane == 0:
        large[fetch_add(larges, 0, 1)] = wp.vec2i(slot, columns)


@wp.kernel
def _scan_large(
    begin: int,
    tree: Tree,
    slab: Slab,
    lanes: int,
    groups: int,
    counts: wp.array(dtype=wp.int32),
    full: wp.array(dtype=wp.int32),
    packed: int,
    large: wp.array(dtype=wp.vec2i),
    larges: wp.array(dtype=wp.int32),
):
    """Mark the columns of those: each triangle is the work of up to so many groups of lanes."""
    thread = begin + wp.tid()
    item = wp.int64(thread / lanes)
    # Pieces of 100 million triangles are more than 32 bits count.
    while item < _PIECES_64 * wp.int64(larges[0]):
        noted = large[wp.int32(item / _PIECES_64)]
        lane = wp.int32(item % _PIECES_64) * lanes + thread % lanes
        if lane < noted[1]:
            mark_triangle(tree, slab, counts, full, packed, noted[0], ANY, lane, PIECES * lanes)
        item = item + wp.int64(groups)


@wp.kernel
def _sum_columns(begin: int, slab: Slab, counts: wp.array(dtype=wp.int32), values: wp.array(dtype=wp.float32)):
    """From crossings to winding numbers, in the same memory: a voxel sees every crossing at or beyond it."""
    i = begin + wp.tid()
    columns = slab.shape[1] * slab.shape[2]
    mesh = i / columns
    here = slab_of(slab, mesh)
    layer = here.shape[1] * here.shape[2]
    column = i - mesh * columns
    if column >= layer:
        return
    at = start_of_mesh(here, mesh) + column
    total = int(0)
    end = here.shape[0]
    while end >= AHEAD:
        # All loads before any store, which each would wait for.
        ahead = Ahead()
        for back in range(AHEAD):
            ahead[back] = counts[at + (end - 1 - back) * layer]
        for back in range(AHEAD):
            total = total + ahead[back]
            values[at + (end - 1 - back) * layer] = float(total)
        end = end - AHEAD
    while end > 0:
        end = end - 1
        total = total + counts[at + end * layer]
        values[at + end * layer] = float(total)


@wp.func
def numbered_voxel(tree: Tree, slab: Slab, number: int):
    """The mesh and the indices of a voxel of a batch, counted with k fastest, and its centre (scaled)."""
    mesh, at = unravel(number, slab.shape)
    p = tree.frame[mesh * FRAME_SIZE + SCALE] * wp.vec3d(voxel(slab, at[0], at[1], at[2]))
    return mesh, at[0], at[1], at[2], p


@wp.kernel
def _count_at_voxels(
    begin: int, tree: Tree, caps: Tree, with_caps: int, slab: Slab, values: wp.array(dtype=wp.float32)
):
    """One ray for every voxel: for turned grids, whose columns are not along x."""
    number = begin + wp.tid()
    mesh, at = voxel_at(slab, number)
    p = tree.frame[mesh * FRAME_SIZE + SCALE] * wp.vec3d(voxel(slab_of(slab, mesh), at[0], at[1], at[2]))
    found = count_crossings(tree_of(tree, mesh), mesh, p)
    if with_caps != 0:
        found = found + count_crossings(tree_of(caps, mesh), mesh, p)
    values[number] = float(found)


@wp.kernel
def _add_boundary(begin: int, tree: Tree, winding: Winding, slab: Slab, values: wp.array4d(dtype=wp.float32)):
    mesh, i, j, k, p = numbered_voxel(tree, slab, begin + wp.tid())
    share = float(0.0)
    if winding.kind == SOUP:
        share = float(soup_winding(tree, winding.moments, mesh, p))
    else:
        share = float(boundary_winding(winding.boundary, tree, mesh, p))
    values[mesh, i, j, k] = values[mesh, i, j, k] + share


def lanes_for_each(triangles: int, meshes: int, columns: int, fewest: int, most: int) -> int:
    """Lanes of a GPU for each of a mesh's triangles: for some times the columns that one covers, as some cover more.

    A power of two times the fewest; of many meshes no more than there are threads to count.
    """
    lanes = fewest
    while lanes < most and lanes * triangles < 4 * columns and lanes * triangles * meshes < MOST_THREADS:
        lanes *= 2
    return lanes


def scan_triangles(
    tree: Tree,
    slab: Slab,
    crossings: Crossings,
    meshes: int,
    empty: Callable[[int, Any], wp.array],
    most_columns: int | None = None,
) -> None:
    """Add to `crossings` of the voxels of each mesh's slab where all triangles cross its columns.

    One that lies under `most_columns` for each lane or more is the work of many groups.
    """
    device = crossings.counts.device
    counts = [crossings.counts, crossings.full, int(crossings.packed)]
    columns = slab.shape[1] * slab.shape[2]
    slots = tree.face.shape[0]
    lanes = lanes_for_each(-(-slots // meshes), meshes, columns, 1, GPU_LANES) if device.is_cuda else 1
    most = most_columns or MOST_COLUMNS["cuda" if device.is_cuda else "cpu"]
    some_large = columns >= most * lanes
    large, larges = empty(slots if some_large else 1, wp.vec2i), new_zeros(empty, 1)
    launch(_scan_convert, slots * lanes, [tree, slab, lanes, most, *counts, large, larges], device)
    if some_large:
        lanes, groups = (GPU_LANES, gpu_workers(device, BLOCKS_PER_SM)) if device.is_cuda else (1, threads())
        inputs = [tree, slab, lanes, groups, *counts, large, larges]
        launch(_scan_large, groups * lanes, inputs, device, smallest=1)


# "caps" for the fast way of open meshes, "edges" for the sum over all boundary edges at each voxel: tests compare them.
OPEN_METHOD = "caps"
# Whether a CPU has ways of its own, or those of a GPU: tests compare them, too.
BY_EIGHTS = True


def begin_crossings(
    winding: Winding, slab: Slab, values: wp.array, empty: Callable[[int, Any], wp.array], alone: bool = False
) -> Crossings | None:
    """Memory for the crossings of columns, zeroed, if they are to be packed; it may be there before a tree is.

    For `alone` see `can_be_packed`.
    """
    kind = "cuda" if values.device.is_cuda else "cpu"
    if winding.kind == SOUP or winding.caps.are_faces or not can_be_packed(slab, values.size, kind, alone):
        return None
    return new_packed(slab, values.size, empty)


def slab_winding(
    tree: Tree,
    winding: Winding,
    slab: Slab,
    values: wp.array,
    empty: Callable[[int, Any], wp.array],
    most_columns: int | None = None,
    before_boundary: Callable[[], Callable[[], None]] = lambda: _nothing,
    is_zero: bool = False,
    crossings: Crossings | None = None,
) -> None:
    """Winding numbers of each mesh at each voxel of a slab, for its sign.

    Fills `values` (meshes, n, ny, nz) float32, or of meshes that have grids of their own all in one row, each as if it
    were closed. Where an open mesh's winding number is within a quarter of a whole number, it may be that number
    instead. `empty(length, dtype)` allocates workspace; for `most_columns` see `PlanOptions`.
    `before_boundary` is called once all is queued that needs neither boundary nor caps, and what it gives before the
    caps' moments are looked at. `is_zero`: `values` are. `crossings`: what `begin_crossings` gave.
    """
    device, total, meshes = values.device, values.size, slab.meshes or values.shape[0]
    flat = values.flatten()
    # Caps close the holes, and are opened again, unless the edges are few.
    fast = winding.kind not in (CLOSED, SOUP) and OPEN_METHOD == "caps"
    kind, edges = "cuda" if device.is_cuda else "cpu", winding.boundary.count
    few = fast and edges * total <= MOST_SUMS[kind]
    fewest, most = FACES_AN_EDGE[kind]
    loose = fewest * edges <= tree.count <= most * edges
    by_edges = fast and not few and loose and edges <= MOST_EDGES[kind]
    with_caps = fast and not few and not by_edges
    if winding.kind == SOUP or (with_caps and winding.caps.are_faces):
        if not is_zero:
            values.zero_()
        before_moments = before_boundary()
    elif slab.turned != 0:
        before_moments = before_boundary()
        launch(_count_at_voxels, total, [tree, winding.caps.tree, int(with_caps), slab, flat], device)
    else:
        if crossings is None and not is_zero:
            crossings = begin_crossings(winding, slab, values, empty)
        if crossings is None:
            if not is_zero:
                values.zero_()
            crossings = Crossings(flat.view(wp.int32), flat.view(wp.int32), False)
        scan_triangles(tree, slab, crossings, meshes, empty, most_columns)
        before_moments = before_boundary() if with_caps else _nothing
        if with_caps:
            scan_triangles(winding.caps.tree, slab, crossings, meshes, empty, most_columns)
        if crossings.packed:
            sum_packed(slab, crossings, flat)
        else:
            launch(_sum_columns, meshes * slab.shape[1] * slab.shape[2], [slab, crossings.counts, flat], device)
        if not with_caps:
            before_moments = before_boundary()
        if crossings.packed:
            # By rays, which ask the tree.
            count_full(tree, winding.caps.tree, with_caps, slab, crossings, flat)
    before_moments()
    if with_caps and kind == "cpu" and BY_EIGHTS:
        open_caps_by_eights(tree, winding.boundary, winding.caps, slab, values, empty)
    elif with_caps:
        open_caps(tree, winding.boundary, winding.caps, slab, values, empty)
    elif by_edges and kind == "cpu" and BY_EIGHTS:
        open_edges_by_eights(tree, winding.boundary, slab, values, empty)
    elif by_edges:
        open_edges(tree, winding.boundary, winding.caps, slab, values, empty)
    elif few:
        add_rims(tree, winding.boundary, slab, flat)
    elif winding.kind != CLOSED:
        launch(_add_boundary, total, [tree, winding, slab, values], device)


def _nothing() -> None:
    pass
