"""Blocks of 8^3 voxels near the surface, triangle by triangle: as a GPU marks those of grids that are not turned.

Each triangle tries the blocks of the box around it that its plane passes near, lanes of it side by side. No tree is
descended, so the blocks can be found while the tree's boxes are still made, and the time is that of one try and not of
a long chain of reads. The three bounds are those of `surface_boxes`.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.band.block_bits import BlockBits, is_marked, mark_block
from sdm.kernels.band.surface_boxes import ROUNDING, box_gap2, triangle_may_reach
from sdm.kernels.bvh.tree import SCALE, Tree, load_corners
from sdm.kernels.geometry.block_table import BITS
from sdm.kernels.geometry.voxel_box import box_of_voxels
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add

wp.set_module_options({"enable_backward": False})

# Lanes of one triangle at most, and of all together about as many as a GPU has something to do for.
MOST_LANES, MOST_THREADS = 1 << 15, 1 << 17
# Of more triangles than these threads, each thread takes a few, if they have no more than so many blocks to try.
RUN, MOST_TRIED = 4, 256
# A triangle with more columns of blocks for each lane is left to a second launch, with many lanes for each; of so many
# there is room. Otherwise one large triangle among many small ones would take longer than all the others together.
MOST_COLUMNS, MOST_LARGE, LARGE_THREADS, LARGE_LANES = 64, 1 << 14, 1 << 16, 1 << 10
ALL = 1 << 30


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


@wp.func
def largest_coordinate(slab: Slab, scale: wp.float64):
    """A bound of the (scaled) coordinates of the grid."""
    largest = float(0.0)
    for axis in range(3):
        span = wp.float64(slab.shape[axis] + wp.where(axis == 0, slab.first, 0)) * slab.spacing[axis]
        largest = wp.max(largest, float(scale * (wp.abs(slab.origin[axis]) + span)))
    return largest


@wp.func
def mark_one(tree: Tree, slab: Slab, reach: float, bits: BlockBits, slot: int, lane: int, lanes: int, most: int):
    """Set the bits of blocks near a triangle, in this lane's columns of them; True if there are too many for a lane.

    Then none is looked at.
    """
    scale = tree.frame[SCALE]
    a, b, c, n = load_corners(tree, slot)
    low = wp.min(a, wp.min(b, c))
    high = wp.max(a, wp.max(b, c))
    # What rounding adds, anywhere in the grid.
    largest = largest_coordinate(slab, scale)
    half = wp.vec3()
    for axis in range(3):
        half[axis] = float(scale * wp.float64(3.5) * slab.spacing[axis])
    within = reach * float(scale) * (1.0 + ROUNDING) + ROUNDING * (1.0 + largest)
    within2 = within * within
    i_begin, i_last = blocks_within(slab, 0, low[0] - within, high[0] + within, scale)
    j_begin, j_last = blocks_within(slab, 1, low[1] - within, high[1] + within, scale)
    k_begin, k_last = blocks_within(slab, 2, low[2] - within, high[2] + within, scale)
    if i_begin > i_last or j_begin > j_last or k_begin > k_last:
        return False
    width = j_last - j_begin + 1
    columns = (i_last - i_begin + 1) * width
    if columns / lanes > most:
        return True
    # A column's blocks that the plane is near: of those whose middle is at most so far from it.
    thick = within + wp.dot(wp.vec3(wp.abs(n[0]), wp.abs(n[1]), wp.abs(n[2])), half) * 1.00001
    rise = n[2] * float(scale * wp.float64(8.0) * slab.spacing[2])
    lowest = middle_of_block(slab, 2, 0, scale) - a[2]
    column = int(lane)
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
    return False


@wp.func
def leave_large(
    tree: Tree,
    slab: Slab,
    reach: float,
    bits: BlockBits,
    slot: int,
    large: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
):
    """List a triangle for the second launch; one that finds no room is gone through."""
    place = fetch_add(counts, 0, 1)
    if place < large.shape[0]:
        large[place] = slot
    else:
        mark_one(tree, slab, reach, bits, slot, 0, 1, ALL)


@wp.kernel
def _mark_triangles(
    begin: int,
    lanes: int,
    tree: Tree,
    slab: Slab,
    reach: float,
    bits: BlockBits,
    large: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    slot = thread / lanes
    lane = thread % lanes
    if mark_one(tree, slab, reach, bits, slot, lane, lanes, MOST_COLUMNS) and lane == 0:
        leave_large(tree, slab, reach, bits, slot, large, counts)


@wp.kernel
def _mark_runs(
    begin: int,
    tree: Tree,
    slab: Slab,
    reach: float,
    bits: BlockBits,
    large: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
):
    """`_mark_triangles` of a few triangles that follow each other, and so lie side by side."""
    first = RUN * (begin + wp.tid())
    last = wp.min(first + RUN, tree.face.shape[0])
    scale = tree.frame[SCALE]
    low = wp.vec3(wp.inf, wp.inf, wp.inf)
    high = -low
    for slot in range(first, last):
        a, b, c, _normal = load_corners(tree, slot)
        low = wp.min(low, wp.min(a, wp.min(b, c)))
        high = wp.max(high, wp.max(a, wp.max(b, c)))
    within = reach * float(scale) * (1.0 + ROUNDING) + ROUNDING * (1.0 + largest_coordinate(slab, scale))
    within2 = within * within
    i_begin, i_last = blocks_within(slab, 0, low[0] - within, high[0] + within, scale)
    j_begin, j_last = blocks_within(slab, 1, low[1] - within, high[1] + within, scale)
    k_begin, k_last = blocks_within(slab, 2, low[2] - within, high[2] + within, scale)
    if i_begin > i_last or j_begin > j_last or k_begin > k_last:
        return
    tried = wp.int64((i_last - i_begin + 1) * (j_last - j_begin + 1)) * wp.int64(k_last - k_begin + 1)
    if tried > wp.int64(MOST_TRIED):
        for slot in range(first, last):
            if mark_one(tree, slab, reach, bits, slot, 0, 1, MOST_COLUMNS):
                leave_large(tree, slab, reach, bits, slot, large, counts)
        return
    for i in range(i_begin, i_last + 1):
        for j in range(j_begin, j_last + 1):
            for k in range(k_begin, k_last + 1):
                at = wp.vec3i(i, j, k)
                if not is_marked(bits, at):
                    box = box_of_voxels(slab, 8 * at, 8, float(scale))
                    slot = int(first)
                    if box_gap2(low, high, box) > within2:
                        slot = last
                    while slot < last:
                        a, b, c, n = load_corners(tree, slot)
                        if triangle_may_reach(a, b, c, n, box, within, within2):
                            mark_block(bits, at)
                            slot = last
                        slot = slot + 1


@wp.kernel
def _mark_large(
    begin: int,
    groups: int,
    lanes: int,
    tree: Tree,
    slab: Slab,
    reach: float,
    bits: BlockBits,
    large: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    number = thread / lanes
    while number < wp.min(counts[0], large.shape[0]):
        mark_one(tree, slab, reach, bits, large[number], thread % lanes, lanes, ALL)
        number = number + groups


def mark_triangles(tree: Tree, slab: Slab, reach: float, bits: Any, large: wp.array, counts: wp.array) -> None:
    """Set the bits of the blocks with a voxel that may be within `reach` of some triangle of one mesh.

    Args:
        tree: Of the mesh: its corners are read, not its boxes.
        slab: The voxels, of a grid that is not turned.
        reach: In the mesh's unit.
        bits: See `BlockBits`.
        large: (MOST_LARGE,) int32, workspace.
        counts: int32, the first a zero: how many triangles were left to the second launch.
    """
    device = tree.face.device
    triangles, lanes = tree.face.shape[0], 1
    # About one for each column of a fine grid's blocks.
    threads = max(MOST_THREADS, slab.shape[0] * slab.shape[1] >> (2 * BITS))
    while device.is_cuda and lanes < MOST_LANES and lanes * triangles < threads:
        lanes *= 2
    if triangles >= MOST_THREADS:
        launch(_mark_runs, -(-triangles // RUN), [tree, slab, reach, bits, large, counts], device)
    else:
        launch(_mark_triangles, triangles * lanes, [lanes, tree, slab, reach, bits, large, counts], device)
    workers, each = (LARGE_THREADS, LARGE_LANES) if device.is_cuda else (16, 1)
    launch(_mark_large, workers, [workers // each, each, tree, slab, reach, bits, large, counts], device, smallest=1)
