"""Lines of the distance transform whose voxels are all close to the other class, as in noise.

There each voxel asks its few neighbours on the line instead of all. The pass before knows which lines these are: it
marks the others. A line may be near on one side and far on the other.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# A line is marked if one of its voxels might have to look further than this. In noise whose voxels are twice as long
# along rows as along lines, six would mark nine lines in ten, twelve one in twenty.
NEIGHBOURS = 12


@wp.func
def cost(x: int, site: int, height: float, weight: float, half: float):
    """Squared distance at x through the voxel at `site`."""
    away = wp.max(float(wp.abs(x - site)) - half, 0.0)
    return height + weight * (away * away)


@wp.struct
class Marks:
    """Marks of the lines that have a voxel far from the other class: one for each line of a pass, not zero where so."""

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
            best = wp.min(best, cost(k, 0, wp.max(side * heights[base + (x - k) * stride], 0.0), weight, half))
        if x + k < length:
            best = wp.min(best, cost(k, 0, wp.max(side * heights[base + (x + k) * stride], 0.0), weight, half))
        k = k + 1
        added = cost(k, 0, 0.0, weight, half)
    return side * best


@wp.func
def finished(squared: float, scale: float, missing: float):
    """Output for a squared distance: itself, or with a `scale` above zero the distance."""
    if scale > 0.0:
        return wp.where(squared < wp.inf, scale * wp.sqrt(squared), missing)
    return squared


@wp.func
def first_voxel(line: int, length: int, stride: int):
    """Index of a line's first voxel: lines side by side fill a stride, and then a whole length of strides."""
    outer = line / stride
    return outer * stride * length + (line - outer * stride)


@wp.func
def first_crossing(line: int, length: int, stride: int, across: int):
    """The line of the next pass through a line's first voxel; those through the others are a stride apart."""
    outer = line / stride
    return outer / across * stride * length + (line - outer * stride)


@wp.func
def first_of(piece: int, pieces: int, length: int):
    """The first voxel of a piece of a line."""
    return piece * length / pieces


@wp.kernel
def nearest_among_neighbours(
    begin: int,
    lines: int,
    pieces: int,
    heights: wp.array(dtype=wp.float32),
    length: int,
    stride: int,
    weight: float,
    half: float,
    marks: Marks,
    scale: float,
    missing: float,
    following: Marks,
    across: int,
    out: wp.array(dtype=wp.float32),
):
    """Voxels of the sides on which a line is not far, by `pieces` threads a line: see `edt_along` for the rest."""
    thread = begin + wp.tid()
    piece = thread / lines
    line = thread - piece * lines
    base = first_voxel(line, length, stride)
    crossing = first_crossing(line, length, stride, across)
    outside = marks.outside[line] == 0
    inside = marks.inside[line] == 0
    if outside or inside:
        for x in range(first_of(piece, pieces, length), first_of(piece + 1, pieces, length)):
            at = base + x * stride
            value = heights[at]
            if (value < 0.0 and inside) or (value >= 0.0 and outside):
                near = from_neighbours(heights, base, stride, length, x, weight, half)
                mark(following, crossing + x * stride, near)
                out[at] = wp.where(value < 0.0, -1.0, 1.0) * finished(wp.abs(near), scale, missing)
