"""Later passes of the distance transform: each voxel of a far line takes the best that envelopes offer.

It asks those of the line's pieces (see `edt_lines`), the nearest first: a piece further away than what all voxels of a
tile have found is not asked.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.edt.envelopes import find_envelope, height_for, site_of, start_of
from sdm.kernels.edt.short_range import Marks, cost, finished, first_crossing, first_of, first_voxel, mark
from sdm.kernels.primitives.lanes import on_cpu

wp.set_module_options({"enable_backward": False})

# Voxels that ask together.
TILE = 8
Tile = wp.types.vector(length=TILE, dtype=wp.float32)


@wp.func
def is_on(value: float, side: float):
    """True if a voxel of this value is on a side. Zero is what is inside of a transform without signs."""
    return value * side > 0.0 or (value == 0.0 and side > 0.0)


@wp.func
def largest(tile: Tile):
    most = float(0.0)
    for i in range(TILE):
        most = wp.max(most, tile[i])
    return most


@wp.func
def entry_at(x: int, stack: wp.array(dtype=wp.int32), first: int, count: int, stride: int):
    """The last of `count` > 0 entries from `stack[first]` that begins at x or before; the first one begins at 0."""
    low = int(0)
    high = int(count - 1)
    while low < high:
        middle = (low + high + 1) / 2
        if start_of(stack[first + middle * stride]) <= x:
            low = middle
        else:
            high = middle - 1
    return low


@wp.func
def lessened(
    best: Tile,
    x: int,
    stack: wp.array(dtype=wp.int32),
    first: int,
    count: int,
    entry: int,
    heights: wp.array(dtype=wp.float32),
    base: int,
    stride: int,
    length: int,
    weight: float,
    half: float,
    side: float,
):
    """`best` of the voxels from x, and what the `count` > 0 entries from `stack[first]` offer them, from one before x.

    Also gives the last entry that was looked at.
    """
    site = site_of(stack[first + entry * stride])
    height = height_for(heights[base + site * stride], side)
    following = int(length)
    if entry + 1 < count:
        following = start_of(stack[first + (entry + 1) * stride])
    for i in range(TILE):
        while following <= x + i and entry + 1 < count:
            entry = entry + 1
            site = site_of(stack[first + entry * stride])
            following = length
            if entry + 1 < count:
                following = start_of(stack[first + (entry + 1) * stride])
            if following > x + i:
                height = height_for(heights[base + site * stride], side)
        best[i] = wp.min(best[i], cost(x + i, site, height, weight, half))
    return best, entry


@wp.func
def walk(
    heights: wp.array(dtype=wp.float32),
    base: int,
    stride: int,
    length: int,
    weight: float,
    half: float,
    side: float,
    stack: wp.array(dtype=wp.int32),
    count: int,
    scale: float,
    missing: float,
    following: Marks,
    crossing: int,
    out: wp.array(dtype=wp.float32),
):
    """A line with one envelope, of `count` entries: from voxel to voxel and entry to entry."""
    entry = int(0)
    site = int(0)
    height = float(wp.inf)
    until = int(length)
    if count > 0:
        until = 0
        entry = -1
    for x in range(length):
        while until <= x:
            entry = entry + 1
            site = site_of(stack[base + entry * stride])
            height = height_for(heights[base + site * stride], side)
            until = length
            if entry + 1 < count:
                until = start_of(stack[base + (entry + 1) * stride])
        at = base + x * stride
        value = heights[at]
        if is_on(value, side):
            best = wp.min(wp.abs(value), cost(x, site, height, weight, half))
            mark(following, crossing + x * stride, side * best)
            out[at] = side * finished(best, scale, missing)


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
    side: float,
    far: wp.array(dtype=wp.int32),
    stack: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    scale: float,
    missing: float,
    following: Marks,
    across: int,
    out: wp.array(dtype=wp.float32),
):
    """Voxels of one side (1 outside, -1 inside) on each far line: out[x] = min over i of height of i + cost(x - i).

    A height below zero belongs to a voxel inside: seen from outside it is zero, and the other way round. With a
    `scale` above zero the result is no longer squared. The lines of the next pass, `across` of which this one's voxels
    are the first, second, ... voxels, are marked in `following`. There are `pieces` threads a line.
    """
    thread = begin + wp.tid()
    piece = thread / lines
    line = thread - piece * lines
    if far[line] == 0:
        return
    base = first_voxel(line, length, stride)
    crossing = first_crossing(line, length, stride, across)
    begin_at = first_of(piece, pieces, length)
    x = int(begin_at)
    end = first_of(piece + 1, pieces, length)
    if on_cpu() and pieces == 1:
        # Here, where the line is at hand, and not in a launch of its own.
        found = find_envelope(heights, base, stride, length, 0, length, weight, half, side, stack)
        walk(heights, base, stride, length, weight, half, side, stack, found, scale, missing, following, crossing, out)
        return
    # Where the envelope of the own piece was left.
    here = int(0)
    while x < end:
        # What is not on this side has nothing to gain.
        best = Tile()
        for i in range(TILE):
            value = float(0.0)
            if x + i < end:
                value = heights[base + (x + i) * stride]
            best[i] = wp.where(x + i < end and is_on(value, side), wp.abs(value), -1.0)
        most = largest(best)
        turn = int(0)
        while turn < 2 * pieces - 1 and most > 0.0:
            away = (turn + 1) / 2
            other = piece + wp.where((turn & 1) != 0, -away, away)
            if other >= 0 and other < pieces:
                low = first_of(other, pieces, length)
                high = first_of(other + 1, pieces, length)
                gap = wp.max(wp.max(low - (x + TILE - 1), x - (high - 1)), 0)
                count = counts[other * lines + line]
                if count > 0 and cost(gap, 0, 0.0, weight, half) < most:
                    pile = base + low * stride
                    entry = here
                    if turn > 0 or x == begin_at:
                        entry = entry_at(x, stack, pile, count, stride)
                    best, entry = lessened(
                        best, x, stack, pile, count, entry, heights, base, stride, length, weight, half, side
                    )
                    if turn == 0:
                        here = entry
                    most = largest(best)
            turn = turn + 1
        for i in range(TILE):
            if best[i] >= 0.0:
                mark(following, crossing + (x + i) * stride, side * best[i])
                out[base + (x + i) * stride] = side * finished(best[i], scale, missing)
        x = x + TILE
