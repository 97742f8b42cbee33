"""The grid of a flood: voxels, lengths between them, and lower bounds of the distance on the way from one to another.

All that is known about the surface here is its distance from every voxel, unsigned and exact. Take two voxels L apart
whose distances are a and b, and the point q of the segment between them that is closest to the surface, with p the
closest point there. If q is within the segment, p - q is square to it, so by Pythagoras a^2 <= t^2 + |p - q|^2 and
b^2 <= (L - t)^2 + |p - q|^2, with t the way from the first voxel to q: wherever q is, |p - q|^2 is at least the
smallest that max(a^2 - t^2, b^2 - (L - t)^2) can be, the square of the height of a triangle with the sides a, b and L.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class FloodGrid:
    """Voxels (nx,ny,nz), counted k fastest, and what a flood needs to know about lengths."""

    shape: wp.vec3i
    spacing: wp.vec3d
    origin: wp.vec3d  # centre of voxel (0,0,0)
    axes: wp.mat33d  # columns from one voxel to the next along i, j and k
    low: wp.vec3i  # voxels below it along any axis are beyond the mesh's box, voxel 0 among them
    high: wp.vec3i  # as are those above it
    radius: wp.float64  # of the ball that floods
    deep: wp.float64  # so far from the surface the ball moves freely to all neighbours, and on to theirs
    slack: wp.float64  # rounding of distances


@wp.func
def is_beyond(grid: FloodGrid, i: int, j: int, k: int):
    """True if a voxel lies beyond the mesh's box, where everything is outside."""
    below = i < grid.low[0] or j < grid.low[1] or k < grid.low[2]
    return below or i > grid.high[0] or j > grid.high[1] or k > grid.high[2]


@wp.func
def is_in_grid(grid: FloodGrid, i: int, j: int, k: int):
    """True if there is such a voxel."""
    return i >= 0 and j >= 0 and k >= 0 and i < grid.shape[0] and j < grid.shape[1] and k < grid.shape[2]


@wp.func
def number_of(grid: FloodGrid, i: int, j: int, k: int):
    """The number of a voxel."""
    return (i * grid.shape[1] + j) * grid.shape[2] + k


@wp.func
def length_of(grid: FloodGrid, i: int, j: int, k: int):
    """Length of so many steps along each axis."""
    return wp.length(wp.cw_mul(grid.spacing, wp.vec3d(wp.float64(i), wp.float64(j), wp.float64(k))))


@wp.func
def is_free(grid: FloodGrid, a: wp.float64, b: wp.float64, length: wp.float64):
    """True if a segment between points at distances a and b surely crosses no surface: their balls cover it."""
    return a + b > length + grid.slack


@wp.func
def clearance2(a: wp.float64, b: wp.float64, length: wp.float64):
    """Square of a distance that every point of such a segment, if it is free, has from the surface at least."""
    foot = (a * a - b * b + length * length) / (wp.float64(2.0) * length)
    if foot <= wp.float64(0.0):
        return a * a
    if foot >= length:
        return b * b
    return a * a - foot * foot


@wp.func
def is_open(grid: FloodGrid, a: wp.float64, b: wp.float64, length: wp.float64):
    """True if the ball surely passes along such a segment."""
    return is_free(grid, a, b, length) and clearance2(a, b, length) >= grid.radius * grid.radius
