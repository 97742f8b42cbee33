"""Scan conversion: where a triangle crosses the columns of voxels along x.

It marks the last voxel before it, in every column that it covers; a sum along each column turns marks into winding
numbers, see `column_sums`, and of a narrow band's blocks `sdm.kernels.band.block_winding`.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, LATTICE_SLACK, SCALE, Tree, load_corners, mesh_of_slot, to_lattice
from sdm.kernels.geometry.voxel_grid import Slab, along, count_below, index_of, slab_of
from sdm.kernels.winding.columns.packed_crossings import add_crossing
from sdm.kernels.winding.ray_crossings import covers, crossing_of

wp.set_module_options({"enable_backward": False})


@wp.func
def columns_under(slab: Slab, pa: wp.vec3, pb: wp.vec3, pc: wp.vec3, scale: wp.float64):
    """Columns (j,k) that a triangle's box covers: first j and k, their number along k, and that of all.

    None if the triangle is before the first voxels.
    """
    low = wp.min(pa, wp.min(pb, pc))
    high = wp.max(pa, wp.max(pb, pc))
    if count_below(slab, 0, wp.float64(high[0]), scale) == 0:
        return 0, 0, 1, 0
    # Columns are snapped before they are tested, hence the slack.
    j_begin = count_below(slab, 1, wp.float64(low[1]) - LATTICE_SLACK, scale)
    j_end = count_below(slab, 1, wp.float64(high[1]) + LATTICE_SLACK, scale)
    k_begin = count_below(slab, 2, wp.float64(low[2]) - LATTICE_SLACK, scale)
    k_end = count_below(slab, 2, wp.float64(high[2]) + LATTICE_SLACK, scale)
    width = k_end - k_begin
    return j_begin, k_begin, width, (j_end - j_begin) * width


@wp.func
def column_crossing(
    tree: Tree,
    slab: Slab,
    mesh: int,
    pa: wp.vec3,
    pb: wp.vec3,
    pc: wp.vec3,
    a: wp.vec2i,
    b: wp.vec2i,
    c: wp.vec2i,
    j: int,
    k: int,
    scale: wp.float64,
):
    """Signed crossing of a column by a triangle, -1 to 1, and the number of voxels before it."""
    q = to_lattice(tree, mesh, scale * wp.float64(along(slab, 1, j)), scale * wp.float64(along(slab, 2, k)))
    sign = covers(a, b, c, q)
    below = int(0)
    if sign != 0:
        below = count_below(slab, 0, crossing_of(a, b, c, pa[0], pb[0], pc[0], q), scale)
    return sign, below


@wp.func
def mark_columns(
    tree: Tree,
    slab: Slab,
    counts: wp.array(dtype=wp.int32),
    full: wp.array(dtype=wp.int32),
    packed: int,
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

    For `counts`, `full` and `packed` see `packed_crossings.Crossings`.

    Returns how many columns its box covers; if those are `most` or more for each lane, nothing is added.
    """
    scale = tree.frame[mesh * FRAME_SIZE + SCALE]
    j_begin, k_begin, width, columns = columns_under(slab, pa, pb, pc, scale)
    if columns / lanes >= most:
        return columns
    column = lane
    while column < columns:
        j = j_begin + column / width
        k = k_begin + column % width
        sign, below = column_crossing(tree, slab, mesh, pa, pb, pc, a, b, c, j, k, scale)
        if below > 0:
            index = index_of(slab, mesh, wp.vec3i(below - 1, j, k))
            add_crossing(counts, full, packed, slab, mesh, index, j, k, sign)
        column = column + lanes
    return columns


@wp.func
def mark_triangle(
    tree: Tree,
    slab: Slab,
    counts: wp.array(dtype=wp.int32),
    full: wp.array(dtype=wp.int32),
    packed: int,
    slot: int,
    most: int,
    lane: int,
    lanes: int,
):
    """`mark_columns` of the triangle in a slot."""
    pa, pb, pc, _normal = load_corners(tree, slot)
    a = tree.lattice[3 * slot]
    b = tree.lattice[3 * slot + 1]
    c = tree.lattice[3 * slot + 2]
    mesh = mesh_of_slot(tree, slot)
    return mark_columns(tree, slab_of(slab, mesh), counts, full, packed, mesh, pa, pb, pc, a, b, c, most, lane, lanes)
