"""Blocks of 8^3 voxels near the surface, triangle by triangle: as a GPU marks those of grids that are not turned.

Each triangle tries the blocks of the box around it that its plane passes near, lanes of it side by side. No tree is
descended, so the blocks can be found while the tree's boxes are still made, and the time is that of one try and not of
a long chain of reads. The three bounds are those of `surface_boxes`.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.band.block_bits import BlockBits, is_marked, mark_block
from sdm.kernels.band.surface_boxes import ROUNDING, triangle_may_reach
from sdm.kernels.bvh.tree import SCALE, Tree, load_corners
from sdm.kernels.geometry.block_table import BITS
from sdm.kernels.geometry.voxel_box import box_of_voxels
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.launch import launch

wp.set_module_options({"enable_backward": False})

# Lanes of one triangle at most, and of all together about as many as a GPU has something to do for.
MOST_LANES, MOST_THREADS = 1 << 15, 1 << 19


@wp.func
def blocks_within(slab: Slab, axis: int, low: float, high: float, scale: wp.float64):
    """Blocks along an axis, first and last, with a voxel between two scaled coordinates, and perhaps one more."""
    first = wp.float64(0.0)
    if axis == 0:
        first = wp.float64(slab.first)
    step = scale * slab.spacing[axis]
    start = scale * slab.origin[axis]
    end = wp.float64(slab.shape[axis])
    begin = wp.clamp((wp.float64(low) - start) / step - first - wp.float64(1.0), wp.float64(-1.0), end)
    last = wp.clamp((wp.float64(high) - start) / step - first + wp.float64(1.0), wp.float64(-1.0), end)
    return wp.max(int(begin), 0) >> BITS, wp.min(int(wp.floor(last)), slab.shape[axis] - 1) >> BITS


@wp.func
def middle_of_block(slab: Slab, axis: int, block: int, scale: wp.float64):
    """The scaled coordinate of the middle of a block."""
    first = wp.float64(0.0)
    if axis == 0:
        first = wp.float64(slab.first)
    at = first + wp.float64(8 * block) + wp.float64(3.5)
    return float(scale * (slab.origin[axis] + at * slab.spacing[axis]))


@wp.kernel
def _mark_triangles(begin: int, lanes: int, tree: Tree, slab: Slab, reach: float, bits: BlockBits):
    thread = begin + wp.tid()
    slot = thread / lanes
    scale = tree.frame[SCALE]
    a, b, c, n = load_corners(tree, slot)
    low = wp.min(a, wp.min(b, c))
    high = wp.max(a, wp.max(b, c))
    # What rounding adds, anywhere in the grid.
    largest = float(0.0)
    half = wp.vec3()
    for axis in range(3):
        span = wp.float64(slab.shape[axis] + wp.where(axis == 0, slab.first, 0)) * slab.spacing[axis]
        largest = wp.max(largest, float(scale * (wp.abs(slab.origin[axis]) + span)))
        half[axis] = float(scale * wp.float64(3.5) * slab.spacing[axis])
    within = reach * float(scale) * (1.0 + ROUNDING) + ROUNDING * (1.0 + largest)
    within2 = within * within
    i_begin, i_last = blocks_within(slab, 0, low[0] - within, high[0] + within, scale)
    j_begin, j_last = blocks_within(slab, 1, low[1] - within, high[1] + within, scale)
    k_begin, k_last = blocks_within(slab, 2, low[2] - within, high[2] + within, scale)
    if i_begin > i_last or j_begin > j_last or k_begin > k_last:
        return
    width = j_last - j_begin + 1
    columns = (i_last - i_begin + 1) * width
    # A column's blocks that the plane is near: of those whose middle is at most so far from it.
    thick = within + wp.dot(wp.vec3(wp.abs(n[0]), wp.abs(n[1]), wp.abs(n[2])), half) * 1.00001
    rise = n[2] * float(scale * wp.float64(8.0) * slab.spacing[2])
    lowest = middle_of_block(slab, 2, 0, scale) - a[2]
    column = thread % lanes
    while column < columns:
        i = i_begin + column / width
        j = j_begin + column % width
        first = int(k_begin)
        last = int(k_last)
        height = n[0] * (middle_of_block(slab, 0, i, scale) - a[0])
        height = height + n[1] * (middle_of_block(slab, 1, j, scale) - a[1]) + n[2] * lowest
        if wp.abs(rise) * float(k_last + 1) > ROUNDING * (1.0 + largest):
            one = (-thick - height) / rise
            other = (thick - height) / rise
            first = wp.max(first, int(wp.clamp(wp.min(one, other), -1.0e6, 1.0e6)) - 1)
            last = wp.min(last, int(wp.clamp(wp.max(one, other), -1.0e6, 1.0e6)) + 1)
        elif wp.abs(height) > thick + 2.0 * ROUNDING * (1.0 + largest):
            last = int(-1)
        for k in range(first, last + 1):
            at = wp.vec3i(i, j, k)
            # Most blocks are near many triangles.
            if not is_marked(bits, at):
                box = box_of_voxels(slab, 8 * at, 8, float(scale))
                if triangle_may_reach(a, b, c, n, box, within, within2):
                    mark_block(bits, at)
        column = column + lanes


def mark_triangles(tree: Tree, slab: Slab, reach: float, bits: Any) -> None:
    """Set the bits of the blocks with a voxel that may be within `reach` of some triangle of one mesh.

    Args:
        tree: Of the mesh: its corners are read, not its boxes.
        slab: The voxels, of a grid that is not turned.
        reach: In the mesh's unit.
        bits: See `BlockBits`.
    """
    triangles, lanes = tree.face.shape[0], 1
    while lanes < MOST_LANES and lanes * triangles < MOST_THREADS:
        lanes *= 2
    if not tree.face.device.is_cuda:
        lanes = 1
    launch(_mark_triangles, triangles * lanes, [lanes, tree, slab, reach, bits], tree.face.device)
