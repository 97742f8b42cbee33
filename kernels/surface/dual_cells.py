"""Cases of cells for dual surfaces, with ambiguous faces decided so that the surface is a manifold.

A dual surface has one vertex for each loop of a cell, and two of them are joined through each piece of the surface that
crosses the face between their cells. An ambiguous face has two pieces. Where both belong to one loop in either cell,
the same two vertices would be joined twice, and four faces would meet there. Such a face is decided the other way: that
divides the loop of both cells into two, one for each piece. It never joins loops, so it makes no other face worse, and
one turn through the faces is enough: those of an axis and of a parity, six times, as no two of them have a common cell.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.surface.marching_cubes import Surface
from sdm.kernels.surface.segment_cells import ALL, Cases, crossings_of, inside_of, is_joined
from sdm.kernels.surface.voxel_rows import BLOCK, SEGMENTS, Voxels, are_there, block_beyond, block_place, segment_of

wp.set_module_options({"enable_backward": False, "max_unroll": 4})

CELLS = BLOCK * SEGMENTS
NONE = -1


@wp.struct
class DualCells:
    """Cells of active blocks, 512 for each: cell 8s + k is at voxel k of segment s."""

    inside: wp.array(dtype=wp.int32)  # a bit for each corner that is inside; NONE where a corner is missing
    joined: wp.array(dtype=wp.int32)  # of each segment, bit 8a + k: the low face along axis a of cell k is joined
    cases: wp.array(dtype=wp.int32)
    loops: wp.array(dtype=wp.int32)  # of each segment, three bits for each cell: the number of its loops
    first: wp.array(dtype=wp.int32)  # the first dual vertex of each segment


@wp.func
def cell_beyond(voxels: Voxels, surface: Surface, block: int, line: int, k: int, way: int):
    """The number of the cell 4dx + 2dy + dz = `way` further on than cell k of a segment, or NONE."""
    i = line / BLOCK + (way >> 2)
    j = line % BLOCK + ((way >> 1) & 1)
    z = k + (way & 1)
    there = block_beyond(voxels, block, 4 * (i / BLOCK) + 2 * (j / BLOCK) + z / BLOCK)
    if there < 0:
        return NONE
    owner = surface.active[there] - 1
    if owner < 0:
        return NONE
    return CELLS * owner + BLOCK * (BLOCK * (i % BLOCK) + j % BLOCK) + z % BLOCK


@wp.func
def decided_case(voxels: Voxels, cases: Cases, surface: Surface, cells: DualCells, cell: int):
    """The case of a cell by the decisions about its faces."""
    inside = cells.inside[cell]
    case = int(cases.first[inside])
    unclear = cases.ambiguous[inside]
    if unclear != 0:
        block = surface.blocks[cell / CELLS]
        line = (cell / BLOCK) % SEGMENTS
        bit = int(1)
        for face in range(6):
            if ((unclear >> face) & 1) != 0:
                axis = face / 2
                owner = cell
                if face % 2 == 1:
                    owner = cell_beyond(voxels, surface, block, line, cell % BLOCK, 4 >> axis)
                if ((cells.joined[owner / BLOCK] >> (8 * axis + owner % BLOCK)) & 1) != 0:
                    case = case + bit
                bit = bit * 2
    return case


@wp.kernel
def _mark_cells(begin: int, voxels: Voxels, cases: Cases, surface: Surface, cells: DualCells):
    at = begin + wp.tid()
    segment = segment_of(voxels, surface.blocks[at / SEGMENTS], at % SEGMENTS)
    crossings = crossings_of(voxels, segment)
    a = are_there(segment, 0)
    b = are_there(segment, 1)
    c = are_there(segment, 2)
    d = are_there(segment, 3)
    # Voxels whose low faces along x, y and z are whole.
    x = a & b & ((a & b) >> 1)
    y = a & c & ((a & c) >> 1)
    z = a & b & c & d
    whole = (x & y & z & (z >> 1)) & ALL
    joined = int(0)
    for k in range(8):
        inside = inside_of(crossings, k)
        cells.inside[BLOCK * at + k] = wp.where(((whole >> k) & 1) != 0, inside, NONE)
        unclear = cases.ambiguous[inside]
        if unclear != 0:
            for axis in range(3):
                there = wp.where(axis == 0, x, wp.where(axis == 1, y, z))
                if ((unclear >> (2 * axis)) & 1) != 0 and ((there >> k) & 1) != 0:
                    if is_joined(voxels, cases, segment, k, inside, 2 * axis):
                        joined = joined | (1 << (8 * axis + k))
    cells.joined[at] = joined


@wp.func
def is_one_loop(voxels: Voxels, cases: Cases, surface: Surface, cells: DualCells, cell: int, face: int):
    """True if both pieces of the surface in an ambiguous face belong to one loop of a cell."""
    case = decided_case(voxels, cases, surface, cells, cell)
    one = cases.loop[12 * case + cases.opposite[2 * face]]
    return one == cases.loop[12 * case + cases.opposite[2 * face + 1]]


@wp.kernel
def _part_loops(begin: int, voxels: Voxels, cases: Cases, surface: Surface, cells: DualCells, axis: int, parity: int):
    at = begin + wp.tid()
    block = surface.blocks[at / SEGMENTS]
    line = at % SEGMENTS
    place = block_place(voxels, block)
    for k in range(8):
        cell = BLOCK * at + k
        inside = cells.inside[cell]
        if inside != NONE and ((cases.ambiguous[wp.max(inside, 0)] >> (2 * axis + 1)) & 1) != 0:
            step = wp.where(axis == 0, line / BLOCK, wp.where(axis == 1, line % BLOCK, k))
            other = cell_beyond(voxels, surface, block, line, k, 4 >> axis)
            if (place[axis] * BLOCK + step) % 2 == parity and other != NONE:
                if cells.inside[wp.max(other, 0)] != NONE:
                    if is_one_loop(voxels, cases, surface, cells, cell, 2 * axis + 1):
                        if is_one_loop(voxels, cases, surface, cells, other, 2 * axis):
                            bit = 1 << (8 * axis + other % BLOCK)
                            # Another thread may change another bit of it.
                            if (cells.joined[other / BLOCK] & bit) != 0:
                                fetch_add(cells.joined, other / BLOCK, -bit)
                            else:
                                fetch_add(cells.joined, other / BLOCK, bit)


def decide_faces(voxels: Any, cases: Any, surface: Any, cells: Any) -> None:
    """Fill in `inside` and `joined` of the cells of active blocks."""
    count, device = cells.joined.shape[0], cells.joined.device
    launch(_mark_cells, count, [voxels, cases, surface, cells], device)
    for axis in range(3):
        for parity in range(2):
            launch(_part_loops, count, [voxels, cases, surface, cells, axis, parity], device)
