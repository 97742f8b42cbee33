"""Later passes of the distance transform: along one line, the lower envelope of one convex curve a voxel.

The scan of Meijster, Roerdink and Hesselink (2000): a stack of the voxels that are closest somewhere on the line, each
with the first place where it is. One thread does one line, so neighbouring threads read neighbouring addresses.

Lines without a voxel far from the other class are left to `edt_near`, whose voxels do not depend on each other: there
several threads share a line.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.edt_near import Marks, cost, from_neighbours, mark

wp.set_module_options({"enable_backward": False})

# A stack's entry keeps two positions in 32 bits.
LONGEST_LINE = (1 << 15) - 1
_LOW = wp.constant((1 << 16) - 1)


@wp.func
def first_won(site: int, height: float, later: int, later_height: float, weight: float, half: float):
    """The first x at which the later voxel costs no more than the earlier one.

    The difference of the two costs grows with x. It is linear before both, between them and after both; at the two
    voxels themselves it is a value of its own, since there a cost is flat over a width of 2 * half.
    """
    need = (wp.float64(later_height) - wp.float64(height)) / wp.float64(weight)
    h = wp.float64(half)
    gap = wp.float64(later - site)
    if half == 0.0:
        # The three pieces are one line.
        centre = wp.float64(0.5) * (need / gap + wp.float64(later + site))
        return int(wp.ceil(wp.clamp(centre, wp.float64(-2.0), wp.float64(40000.0))))
    middle = wp.float64(0.5) * (need / gap + wp.float64(later + site))
    before = int(wp.ceil(wp.clamp(middle - h, wp.float64(-2.0), wp.float64(40000.0))))
    if before < site:
        return before
    top = (gap - h) * (gap - h)
    if -top >= need:
        return site
    if top < need:
        return wp.max(int(wp.ceil(wp.clamp(middle + h, wp.float64(-2.0), wp.float64(40000.0)))), later + 1)
    if later - site == 1:
        return later
    between = wp.float64(0.5) * (need / (gap - h - h) + wp.float64(later + site))
    return int(wp.ceil(wp.clamp(between, wp.float64(site + 1), wp.float64(later))))


@wp.func
def finished(squared: float, scale: float, missing: float):
    """What is written for a squared distance: itself, or with a `scale` above zero the distance."""
    if scale > 0.0:
        return wp.where(squared < wp.inf, scale * wp.sqrt(squared), missing)
    return squared


@wp.kernel
def nearest_on_line(
    begin: int,
    lines: int,
    pieces: int,
    heights: wp.array(dtype=wp.float32),
    length: int,
    stride: int,
    weight: float,
    half: float,
    sides: int,
    scale: float,
    missing: float,
    marks: Marks,
    following: Marks,
    across: int,
    stack: wp.array(dtype=wp.int32),
    out: wp.array(dtype=wp.float32),
):
    """One line: out[x] = min over i of heights[i] + cost(x - i), for the voxels outside, then for those inside.

    A height below zero belongs to a voxel inside: seen from outside it is zero, and the other way round. With a
    `scale` above zero the result is no longer squared. The lines of the next pass, `across` of which this one's voxels
    are the first, second, ... voxels, are marked in `following`. There are `pieces` threads a line.
    """
    thread = begin + wp.tid()
    piece = thread / lines
    line = thread - piece * lines
    outer = line / stride
    base = outer * stride * length + (line - outer * stride)
    # The line of the next pass through x = 0; they are a stride apart.
    crossing = outer / across * stride * length + (line - outer * stride)
    if marks.far[line] == 0:
        for x in range(piece * length / pieces, (piece + 1) * length / pieces):
            near = from_neighbours(heights, base, stride, length, x, weight, half)
            mark(following, crossing + x * stride, near)
            side_of = wp.where(near < 0.0, -1.0, 1.0)
            out[base + x * stride] = side_of * finished(wp.abs(near), scale, missing)
        return
    if piece > 0:
        return
    inside = int(0)
    for turn in range(sides):
        side = float(1.0)
        if turn == 1:
            side = -1.0
        if turn == 0 or inside > 0:
            count = int(0)
            site = int(0)
            start = int(0)
            height = float(0.0)
            ahead = heights[base]
            for u in range(length):
                value = ahead
                if u + 1 < length:
                    ahead = heights[base + (u + 1) * stride]
                if value < 0.0:
                    inside = inside + 1
                g = wp.max(side * value, 0.0)
                if g < wp.inf:
                    popping = count > 0
                    while popping:
                        popping = cost(start, site, height, weight, half) > cost(start, u, g, weight, half)
                        if popping:
                            count = count - 1
                            popping = count > 0
                            if popping:
                                entry = stack[base + (count - 1) * stride]
                                site = entry & _LOW
                                start = entry >> 16
                                height = wp.max(side * heights[base + site * stride], 0.0)
                    won = int(0)
                    if count > 0:
                        # Never before the one below it: costs within a rounding of each other may disagree.
                        won = wp.max(first_won(site, height, u, g, weight, half), start + 1)
                    if won < length:
                        site = u
                        start = won
                        height = g
                        stack[base + count * stride] = site | (start << 16)
                        count = count + 1
            for back in range(length):
                x = length - 1 - back
                value = heights[base + x * stride]
                if value * side > 0.0 or (value == 0.0 and turn == 0):
                    best = float(wp.inf)
                    if count > 0:
                        best = cost(x, site, height, weight, half)
                    if value == 0.0:
                        best = 0.0
                    mark(following, crossing + x * stride, best)
                    out[base + x * stride] = side * finished(best, scale, missing)
                if count > 0 and x == start:
                    count = count - 1
                    if count > 0:
                        entry = stack[base + (count - 1) * stride]
                        site = entry & _LOW
                        start = entry >> 16
                        height = wp.max(side * heights[base + site * stride], 0.0)
