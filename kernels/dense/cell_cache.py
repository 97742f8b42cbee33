"""Cell cache: boxes of cells and their bricks, worked out once and read by all stages that need them.

Each stage needs a cell's box, which takes hundreds of instructions: whole numbers divided, and places in float64. One
lane stores it as the cell gets its first witness; then it is three reads. Witnesses lie beside.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.geometry.voxel_box import VoxelBox, box_of_rows
from sdm.kernels.primitives.vector_loads import load4, write4

wp.set_module_options({"enable_backward": False})

# Floats of a cached box: its centre and half^2; its half-widths and the mesh's diagonal; its first voxel and its mesh.
BOX_FLOATS = 12
_ROWS = BOX_FLOATS // 4
# What the first voxels of cells that are left out have added to their x, so that they are beyond every slab.
LEFT_OUT = 1 << 30


@wp.struct
class CellCache:
    """Boxes and witnesses: surface points seen from centres, as the vector from there and its square."""

    boxes: wp.array(dtype=wp.float32)  # (72 or 8 * regions * BOX_FLOATS) of cells and, if they have any noted, bricks
    witnesses: wp.array(dtype=wp.float32)  # (73 * regions * 4) of regions, then cells, then bricks


@wp.struct
class CachedBox:
    """A box of voxels of one mesh's map."""

    mesh: wp.int32
    start: wp.vec3i  # its first voxel
    box: VoxelBox


@wp.func
def store_box(cache: CellCache, number: int, mesh: int, start: wp.vec3i, cell: VoxelBox):
    """Store the box of cell `number`, or of a brick, see `brick_number`."""
    c = cell.centre
    h = cell.half
    write4(cache.boxes, _ROWS * number, c[0], c[1], c[2], cell.half2)
    write4(cache.boxes, _ROWS * number + 1, h[0], h[1], h[2], cell.diagonal)
    # Whole numbers, bit for bit.
    i = wp.cast(start[0], wp.float32)
    j = wp.cast(start[1], wp.float32)
    k = wp.cast(start[2], wp.float32)
    write4(cache.boxes, _ROWS * number + 2, i, j, k, wp.cast(mesh, wp.float32))


@wp.func
def cached_start(cache: CellCache, number: int):
    """The mesh and the first voxel of cell or brick `number`, as an earlier kernel stored them."""
    r = load4(cache.boxes, _ROWS * number + 2)
    start = wp.vec3i(wp.cast(r[0], wp.int32), wp.cast(r[1], wp.int32), wp.cast(r[2], wp.int32))
    return wp.cast(r[3], wp.int32), start


@wp.func
def cached_region(cache: CellCache, region: int):
    """The mesh and the first voxel of a region, from its first cell, be that left out or not."""
    mesh, start = cached_start(cache, 8 * region)
    return mesh, wp.vec3i(start[0] & (LEFT_OUT - 1), start[1], start[2])


@wp.func
def is_left_out(start: wp.vec3i):
    """True for a region, by its first voxel, that is no more than room for one."""
    return start[1] >= LEFT_OUT


@wp.func
def cached_half2(cache: CellCache, number: int):
    """The square of its half-diagonal."""
    return cache.boxes[BOX_FLOATS * number + 3]


@wp.func
def cached_box(cache: CellCache, number: int):
    """The box of cell or brick `number`, as an earlier kernel stored it."""
    r0 = load4(cache.boxes, _ROWS * number)
    r1 = load4(cache.boxes, _ROWS * number + 1)
    mesh, start = cached_start(cache, number)
    found = CachedBox()
    found.mesh = mesh
    found.start = start
    found.box = box_of_rows(r0, r1)
    return found
