"""Lines of the distance transform whose voxels are all close to the other class, as in noise.

There each voxel asks its few neighbours on the line instead of all. The pass before knows which lines these are: it
marks the others.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# A line is marked if one of its voxels might have to look further than this.
NEIGHBOURS = wp.constant(6)


@wp.func
def cost(x: int, site: int, height: float, weight: float, half: float):
    """Squared distance at x through the voxel at `site`."""
    away = wp.max(float(wp.abs(x - site)) - half, 0.0)
    return height + weight * (away * away)


@wp.struct
class Marks:
    """Which lines have a voxel that is far from the other class: one for each line of a pass, not zero where it has."""

    outside: wp.array(dtype=wp.int32)
    inside: wp.array(dtype=wp.int32)  # of a signed transform
    limit: float  # squared distances beyond this one are far


@wp.func
def mark(marks: Marks, line: int, height: float):
    """Note that a line of the next pass has a voxel with this height, which is below zero inside."""
    if height > marks.limit:
        marks.outside[line] = 1
    elif -height > marks.limit:
        marks.inside[line] = 1


@wp.func
def from_neighbours(
    heights: wp.array(dtype=wp.float32), base: int, stride: int, length: int, x: int, weight: float, half: float
):
    """The value of voxel x of a line that is not marked, with its sign.

    A voxel whose own height is h has nothing to gain from one at a squared distance of h or more.
    """
    value = heights[base + x * stride]
    side = wp.where(value < 0.0, -1.0, 1.0)
    best = wp.abs(value)
    k = int(1)
    added = cost(k, 0, 0.0, weight, half)
    while added < best:
        if x >= k:
            best = wp.min(best, wp.max(side * heights[base + (x - k) * stride], 0.0) + added)
        if x + k < length:
            best = wp.min(best, wp.max(side * heights[base + (x + k) * stride], 0.0) + added)
        k = k + 1
        added = cost(k, 0, 0.0, weight, half)
    return side * best
