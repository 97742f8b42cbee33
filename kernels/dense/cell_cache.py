"""Cell cache: boxes of cells and their bricks, worked out once and read by all stages that need them.

Each stage needs a cell's box, which takes hundreds of instructions: whole numbers divided, and places in float64. One
lane notes it as the cell gets its first witness; then it is three reads.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.dense.workspace import Lists
from sdm.kernels.geometry.voxel_box import VoxelBox, box_of_rows
from sdm.kernels.primitives.vector_loads import load4, write4

wp.set_module_options({"enable_backward": False})

# Floats of a place: its centre and half^2; its half-widths and the mesh's diagonal; its first voxel and its mesh.
PLACE_FLOATS = 12
_ROWS = PLACE_FLOATS // 4


@wp.struct
class Place:
    """A box of voxels of one mesh's map."""

    mesh: wp.int32
    start: wp.vec3i  # its first voxel
    box: VoxelBox


@wp.func
def brick_number(lists: Lists, number: int, octant: int):
    """The number of a cell's brick, in one count with the cells."""
    return 8 * lists.count + 8 * number + octant


@wp.func
def note_place(lists: Lists, number: int, mesh: int, start: wp.vec3i, cell: VoxelBox):
    """Note cell `number`, or a brick, see `brick_number`."""
    c = cell.centre
    h = cell.half
    write4(lists.places, _ROWS * number, c[0], c[1], c[2], cell.half2)
    write4(lists.places, _ROWS * number + 1, h[0], h[1], h[2], cell.diagonal)
    # Whole numbers, bit for bit.
    i = wp.cast(start[0], wp.float32)
    j = wp.cast(start[1], wp.float32)
    k = wp.cast(start[2], wp.float32)
    write4(lists.places, _ROWS * number + 2, i, j, k, wp.cast(mesh, wp.float32))


@wp.func
def noted_start(lists: Lists, number: int):
    """The mesh and the first voxel that were noted of cell or brick `number` by an earlier kernel."""
    r = load4(lists.places, _ROWS * number + 2)
    start = wp.vec3i(wp.cast(r[0], wp.int32), wp.cast(r[1], wp.int32), wp.cast(r[2], wp.int32))
    return wp.cast(r[3], wp.int32), start


@wp.func
def noted_half2(lists: Lists, number: int):
    """The square of its half-diagonal."""
    return lists.places[PLACE_FLOATS * number + 3]


@wp.func
def noted_place(lists: Lists, number: int):
    """Place of cell or brick `number`, as an earlier kernel noted it."""
    r0 = load4(lists.places, _ROWS * number)
    r1 = load4(lists.places, _ROWS * number + 1)
    mesh, start = noted_start(lists, number)
    place = Place()
    place.mesh = mesh
    place.start = start
    place.box = box_of_rows(r0, r1)
    return place
