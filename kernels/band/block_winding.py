"""Winding numbers at the voxels of a band's blocks, as `sdm.kernels.winding.column_sums` has them at all of a grid's.

A triangle crosses a column of voxels next to the surface, so every crossing is marked in a block of the band; those
beyond the grid's last voxels, if there are any, in a layer of their own. The blocks of one line along x are summed one
after the other, from the last on: between them there are no crossings.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import SCALE, Tree, load_corners
from sdm.kernels.geometry.block_table import VOXELS, BlockTable, inner_of, place_of, voxel_of
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import Slab, voxel
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.winding.dipole_tree import soup_winding
from sdm.kernels.winding.ray_crossings import count_crossings
from sdm.kernels.winding.scan_convert import column_crossing, columns_under
from sdm.kernels.winding.winding_number import SOUP, Winding

wp.set_module_options({"enable_backward": False})

# Lanes of one triangle at most, on a GPU.
MOST_LANES = 1 << 16
# And of all together at least about as many, as a GPU runs so many at a time.
FEWEST_LANES = 1 << 20
# A column of voxels in a block.
Column = wp.types.vector(length=8, dtype=wp.int32)


@wp.kernel
def _mark_crossings(
    begin: int,
    lanes: int,
    tree: Tree,
    slab: Slab,
    table: BlockTable,
    counts: wp.array(dtype=wp.int32),
    beyond: wp.array(dtype=wp.int32),
    lost: wp.array(dtype=wp.int32),
):
    """Add a triangle's crossings to the last voxels before them; see `scan_convert.mark_columns`."""
    thread = begin + wp.tid()
    slot = thread / lanes
    lane = thread % lanes
    pa, pb, pc, _normal = load_corners(tree, slot)
    a = tree.lattice[3 * slot]
    b = tree.lattice[3 * slot + 1]
    c = tree.lattice[3 * slot + 2]
    scale = tree.frame[SCALE]
    j_begin, k_begin, width, columns = columns_under(slab, pa, pb, pc, scale)
    known = wp.vec3i(-1, -1, -1)
    place = int(-1)
    column = lane
    while column < columns:
        j = j_begin + column / width
        k = k_begin + column % width
        sign, below = column_crossing(tree, slab, 0, pa, pb, pc, a, b, c, j, k, scale)
        if below > 0:
            at = wp.vec3i(below - 1, j, k)
            block = wp.vec3i(at[0] >> 3, j >> 3, k >> 3)
            # Neighbours are mostly in the same block.
            if not block == known:
                known = block
                place = place_of(table, block)
            if place >= 0:
                fetch_add(counts, VOXELS * place + inner_of(at), sign)
            elif below == slab.shape[0] and beyond.shape[0] > 0:
                fetch_add(beyond, j * slab.shape[2] + k, sign)
            else:
                fetch_add(lost, 0, 1)
        column = column + lanes


@wp.func
def line_of(table: BlockTable, place: int):
    b = table.blocks[place]
    return wp.vec2i(b[1], b[2])


@wp.kernel
def _sum_lines(
    begin: int,
    slab: Slab,
    table: BlockTable,
    order: wp.array(dtype=wp.int32),
    listed: wp.array(dtype=wp.int32),
    beyond: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
):
    """From crossings to winding numbers, in the same memory: one column of all blocks of a line along x."""
    thread = begin + wp.tid()
    at = thread >> 6
    column = thread & 63
    total_blocks = wp.min(listed[0], order.shape[0])
    if at >= total_blocks:
        return
    place = order[at]
    line = line_of(table, place)
    # Whoever is at the last block of a line sums all of it.
    if at + 1 < total_blocks:
        if line_of(table, order[at + 1]) == line:
            return
    total = int(0)
    j = 8 * line[0] + (column >> 3)
    k = 8 * line[1] + (column & 7)
    if beyond.shape[0] > 0 and j < slab.shape[1] and k < slab.shape[2]:
        total = beyond[j * slab.shape[2] + k]
    going = bool(True)
    while going:
        first = VOXELS * place + column
        # All reads before the first write, which is to the same memory: so they are under way together.
        crossings = Column()
        for i in range(8):
            crossings[i] = counts[first + 64 * i]
        at = at - 1
        going = False
        if at >= 0:
            place = order[at]
            going = line_of(table, place) == line
        for back in range(8):
            total = total + crossings[7 - back]
            values[first + 64 * (7 - back)] = float(total)


@wp.kernel
def _count_at_block_voxels(
    begin: int,
    tree: Tree,
    caps: Tree,
    with_caps: int,
    slab: Slab,
    table: BlockTable,
    values: wp.array(dtype=wp.float32),
):
    """One ray for every voxel: for turned grids, whose columns are not along x."""
    number = begin + wp.tid()
    v = voxel_of(table, number)
    if not is_within(slab, v):
        return
    p = tree.frame[SCALE] * wp.vec3d(voxel(slab, v[0], v[1], v[2]))
    found = count_crossings(tree, 0, p)
    if with_caps != 0:
        found = found + count_crossings(caps, 0, p)
    values[number] = float(found)


@wp.kernel
def _soup_at_block_voxels(
    begin: int, tree: Tree, winding: Winding, slab: Slab, table: BlockTable, values: wp.array(dtype=wp.float32)
):
    number = begin + wp.tid()
    v = voxel_of(table, number)
    if is_within(slab, v):
        p = tree.frame[SCALE] * wp.vec3d(voxel(slab, v[0], v[1], v[2]))
        values[number] = float(soup_winding(tree, winding.moments, 0, p))


def whole_windings(
    tree: Tree,
    winding: Winding,
    slab: Slab,
    table: BlockTable,
    order: wp.array,
    listed: wp.array,
    beyond: wp.array,
    values: wp.array,
    lost: wp.array,
) -> None:
    """Winding numbers of one mesh at each voxel of blocks; of an open one as if its holes were closed by caps.

    Args:
        tree: The mesh's hierarchy.
        winding: How its winding numbers are found.
        slab: The whole grid.
        table: The blocks (N,).
        order: (N,) their places, sorted by y, then z, then x.
        listed: (1,) int32, how many there are: N, or less if the rest is room.
        beyond: (ny * nz,) zeros, or nothing if no triangle is beyond the last voxels along x.
        values: (N * 512) filled.
        lost: (1,) to which crossings in no block are added: there are none, if the blocks have all voxels whose
            distance is at most the spacing along x.
    """
    device: Any = values.device
    values.zero_()
    caps = winding.caps.tree
    with_caps = caps.count > 0
    if winding.kind == SOUP:
        launch(_soup_at_block_voxels, values.size, [tree, winding, slab, table, values], device)
    elif winding.caps.are_faces:
        return
    elif slab.turned != 0:
        launch(_count_at_block_voxels, values.size, [tree, caps, int(with_caps), slab, table, values], device)
    else:
        counts = values.view(wp.int32)
        # About one column that a triangle covers for each lane of many.
        columns = max(slab.shape[1] * slab.shape[2], FEWEST_LANES)
        for some in (tree, caps) if with_caps else (tree,):
            triangles, lanes = some.face.shape[0], 1
            while device.is_cuda and lanes < MOST_LANES and lanes * triangles < columns:
                lanes *= 2
            launch(_mark_crossings, triangles * lanes, [lanes, some, slab, table, counts, beyond, lost], device)
        launch(_sum_lines, 64 * order.size, [slab, table, order, listed, beyond, counts, values], device)
