"""Scan conversion: triangles mark where they cross the columns of voxels along x, for a sum along each column.

A triangle marks the last voxel before it, in every column that it covers. Most lie under few columns, and are the work
of one thread or a few; those that lie under many are put aside and shared out, as the others would wait for them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, LATTICE_SLACK, SCALE, Tree, load_corners, mesh_of_slot, to_lattice
from sdm.kernels.geometry.voxel_grid import Slab, along, count_below, index_of, slab_of
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, GPU_LANES, gpu_workers
from sdm.kernels.winding.ray_crossings import covers, crossing_of

wp.set_module_options({"enable_backward": False})

# Columns for each lane from which on a triangle is shared out to many groups of lanes, into so many pieces: where most
# triangles are small, the others would wait for one that lies under half of the grid.
ANY = 1 << 30
MOST_COLUMNS = {"cuda": 64, "cpu": ANY}
PIECES = 64
# Threads of a launch that are enough to choose by: far below what is counted with 32 bits.
MOST_THREADS = 1 << 26
# Two, as Warp takes a constant that a kernel has cast for the cast one from there on.
_PIECES_64 = wp.int64(PIECES)


@wp.func
def mark_columns(
    tree: Tree,
    slab: Slab,
    counts: wp.array(dtype=wp.int32),
    mesh: int,
    pa: wp.vec3,
    pb: wp.vec3,
    pc: wp.vec3,
    a: wp.vec2i,
    b: wp.vec2i,
    c: wp.vec2i,
    most: int,
    lane: int,
    lanes: int,
):
    """Add a triangle's crossing to the last voxel before it, in every column (j,k) that it covers: this lane's of them.

    Returns how many columns its box covers; if those are `most` or more for each lane, nothing is added.
    """
    scale = tree.frame[mesh * FRAME_SIZE + SCALE]
    low = wp.min(pa, wp.min(pb, pc))
    high = wp.max(pa, wp.max(pb, pc))
    if count_below(slab, 0, wp.float64(high[0]), scale) == 0:
        return 0
    # Columns are snapped before they are tested, hence the slack.
    j_begin = count_below(slab, 1, wp.float64(low[1]) - LATTICE_SLACK, scale)
    j_end = count_below(slab, 1, wp.float64(high[1]) + LATTICE_SLACK, scale)
    k_begin = count_below(slab, 2, wp.float64(low[2]) - LATTICE_SLACK, scale)
    k_end = count_below(slab, 2, wp.float64(high[2]) + LATTICE_SLACK, scale)
    width = k_end - k_begin
    columns = (j_end - j_begin) * width
    if columns / lanes >= most:
        return columns
    column = lane
    while column < columns:
        j = j_begin + column / width
        k = k_begin + column % width
        q = to_lattice(tree, mesh, scale * wp.float64(along(slab, 1, j)), scale * wp.float64(along(slab, 2, k)))
        sign = covers(a, b, c, q)
        if sign != 0:
            below = count_below(slab, 0, crossing_of(a, b, c, pa[0], pb[0], pc[0], q), scale)
            if below > 0:
                fetch_add(counts, index_of(slab, mesh, wp.vec3i(below - 1, j, k)), sign)
        column = column + lanes
    return columns


@wp.func
def mark_triangle(
    tree: Tree, slab: Slab, counts: wp.array(dtype=wp.int32), slot: int, most: int, lane: int, lanes: int
):
    """`mark_columns` of the triangle in a slot."""
    pa, pb, pc, _normal = load_corners(tree, slot)
    a = tree.lattice[3 * slot]
    b = tree.lattice[3 * slot + 1]
    c = tree.lattice[3 * slot + 2]
    mesh = mesh_of_slot(tree, slot)
    return mark_columns(tree, slab_of(slab, mesh), counts, mesh, pa, pb, pc, a, b, c, most, lane, lanes)


@wp.kernel
def _scan_convert(
    begin: int,
    tree: Tree,
    slab: Slab,
    lanes: int,
    most: int,
    counts: wp.array(dtype=wp.int32),
    large: wp.array(dtype=wp.vec2i),
    larges: wp.array(dtype=wp.int32),
):
    """Mark the columns of triangles that have few; note the slot and number of columns of those with `most` a lane."""
    thread = begin + wp.tid()
    slot = thread / lanes
    lane = thread % lanes
    columns = mark_triangle(tree, slab, counts, slot, most, lane, lanes)
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
            mark_triangle(tree, slab, counts, noted[0], ANY, lane, PIECES * lanes)
        item = item + wp.int64(groups)


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
    counts: wp.array,
    meshes: int,
    empty: Callable[[int, Any], wp.array],
    most_columns: int | None = None,
) -> None:
    """Add to `counts`, the voxels of each mesh's slab, where all triangles cross its columns.

    One that lies under `most_columns` for each lane or more is the work of many groups.
    """
    device = counts.device
    columns = slab.shape[1] * slab.shape[2]
    slots = tree.face.shape[0]
    lanes = lanes_for_each(-(-slots // meshes), meshes, columns, 1, GPU_LANES) if device.is_cuda else 1
    most = most_columns or MOST_COLUMNS["cuda" if device.is_cuda else "cpu"]
    some_large = columns >= most * lanes
    large, larges = empty(slots if some_large else 1, wp.vec2i), empty(1, wp.int32)
    larges.zero_()
    launch(_scan_convert, slots * lanes, [tree, slab, lanes, most, counts, large, larges], device)
    if some_large:
        lanes, groups = (GPU_LANES, gpu_workers(device, BLOCKS_PER_SM)) if device.is_cuda else (1, threads())
        inputs = [tree, slab, lanes, groups, counts, large, larges]
        launch(_scan_large, groups * lanes, inputs, device, smallest=1)
