"""Boxes of voxel centres, and the octants of a cube of voxels."""

from __future__ import annotations

import warp as wp

from sdm.kernels.geometry.voxel_grid import Slab, voxel

wp.set_module_options({"enable_backward": False})


@wp.struct
class VoxelBox:
    """A box of voxel centres."""

    centre: wp.vec3
    half: wp.vec3
    half2: float  # |half|^2
    diagonal: float  # of the mesh's bounding box: what a witness is rounded by is in units of it


@wp.func
def box_of_rows(first: wp.vec4, second: wp.vec4):
    """A box as it is noted in two rows: centre and half2, then half-widths and diagonal."""
    box = VoxelBox()
    box.centre = wp.vec3(first[0], first[1], first[2])
    box.half2 = first[3]
    box.half = wp.vec3(second[0], second[1], second[2])
    box.diagonal = second[3]
    return box


@wp.func
def box_of_voxels(slab: Slab, start: wp.vec3i, size: int, scale: float):
    """The box of up to size^3 voxels from `start`, in scaled coordinates."""
    return box_between(slab, start, wp.min(start + wp.vec3i(size, size, size), slab.shape) - wp.vec3i(1, 1, 1), scale)


@wp.func
def box_between(slab: Slab, start: wp.vec3i, last: wp.vec3i, scale: float):
    """The box of the voxels from `start` to `last`, in scaled coordinates."""
    low = voxel(slab, start[0], start[1], start[2])
    high = voxel(slab, last[0], last[1], last[2])
    if slab.turned != 0:
        # The box around all corners of a box of a turned grid. Not as a constant, which would write the loop out eight
        # times.
        corners = int(8)
        for corner in range(corners):
            p = voxel(
                slab,
                wp.where((corner & 1) != 0, last[0], start[0]),
                wp.where((corner & 2) != 0, last[1], start[1]),
                wp.where((corner & 4) != 0, last[2], start[2]),
            )
            low = wp.min(low, p)
            high = wp.max(high, p)
    low = scale * low
    high = scale * high
    box = VoxelBox()
    box.centre = 0.5 * (low + high)
    half = wp.max(high - box.centre, box.centre - low)
    # A rounding more than the voxels need, so that none sticks out.
    box.half = half * 1.000001
    box.half2 = wp.dot(box.half, box.half)
    return box


@wp.func
def octant_at(item: int):
    """Position of one of eight parts: 0 or 1 along each axis."""
    return wp.vec3i((item >> 2) & 1, (item >> 1) & 1, item & 1)


@wp.func
def is_within(slab: Slab, start: wp.vec3i):
    return start[0] < slab.shape[0] and start[1] < slab.shape[1] and start[2] < slab.shape[2]
