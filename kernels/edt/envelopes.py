"""Lower envelopes of one convex curve a voxel, along each line of the distance transform's later passes.

The scan of Meijster, Roerdink and Hesselink (2000): a stack of the voxels that are closest somewhere on the line, each
with the first place where it is. A scan is a chain of decisions, and a volume has too few lines to keep a GPU busy with
one each; so there a line is cut into pieces, whose voxels have an envelope of their own, over all of the line. The
nearest voxel is then the nearest of those that the envelopes name, and most pieces are too far away to be asked.

Neighbouring threads have neighbouring lines, so that they read neighbouring addresses.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.edt.short_range import cost, first_of, first_voxel
from sdm.kernels.primitives.lanes import on_cpu

wp.set_module_options({"enable_backward": False})

# A stack's entry keeps two positions in 32 bits.
LONGEST_LINE = (1 << 15) - 1
_LOW = (1 << 16) - 1


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __fdividef(a, b);
#else
    return a / b;
#endif
"""
)
def quotient(a: float, b: float) -> float:
    """a / b; on a GPU within two roundings, for 2^-126 <= b <= 2^126."""
    ...


@wp.func
def quotient(a: wp.float64, b: wp.float64):  # noqa: F811
    return a / b


@wp.func
def first_after(x: Any):
    """The first whole number from x on, of what may lie on a line."""
    return int(wp.ceil(wp.clamp(x, type(x)(-2.0), type(x)(40000.0))))


@wp.func
def solved(site: int, later: int, rise: Any, weight: Any, half: Any):
    """`first_won`, for a later voxel that is higher by `rise`, in the type of these numbers.

    The difference of the two costs grows with x. It is linear before both, between them and after both; at the two
    voxels themselves it is a value of its own, since there a cost is flat over a width of 2 * half.
    """
    gap = type(rise)(later - site)
    centre = type(rise)(later + site)
    middle = type(rise)(0.5) * (quotient(rise, weight * gap) + centre)
    if half == type(rise)(0.0):
        # The three pieces are one line.
        return first_after(middle)
    before = first_after(middle - half)
    if before < site:
        return before
    top = weight * ((gap - half) * (gap - half))
    if -top >= rise:
        return site
    if top < rise:
        return wp.max(first_after(middle + half), later + 1)
    if later - site == 1:
        return later
    between = type(rise)(0.5) * (quotient(rise, weight * (gap - half - half)) + centre)
    return wp.clamp(first_after(between), site + 1, later)


@wp.func
def first_won_by_costs(site: int, height: float, later: int, later_height: float, weight: float, half: float):
    """`first_won` in float32, whose solution is within a tenth: the costs tell which whole number it is."""
    x = solved(site, later, later_height - height, weight, half)
    if cost(x - 1, later, later_height, weight, half) <= cost(x - 1, site, height, weight, half):
        return x - 1
    if cost(x, later, later_height, weight, half) > cost(x, site, height, weight, half):
        return x + 1
    return x


@wp.func
def first_won(site: int, height: float, later: int, later_height: float, weight: float, half: float):
    """The first x at which the later voxel costs no more than the earlier one."""
    if on_cpu():
        rise = wp.float64(later_height) - wp.float64(height)
        return solved(site, later, rise, wp.float64(weight), wp.float64(half))
    return first_won_by_costs(site, height, later, later_height, weight, half)


@wp.func
def height_for(value: float, side: float):
    """A voxel's height as seen from one side (1 for outside, -1 for inside): those of the other are at zero."""
    return wp.max(side * value, 0.0)


@wp.func
def site_of(entry: int):
    """The voxel that an envelope's entry names."""
    return entry & _LOW


@wp.func
def start_of(entry: int):
    """The first place on the line where it is the closest."""
    return entry >> 16


@wp.func
def find_envelope(
    heights: wp.array(dtype=wp.float32),
    base: int,
    stride: int,
    length: int,
    low: int,
    high: int,
    weight: float,
    half: float,
    side: float,
    stack: wp.array(dtype=wp.int32),
):
    """The envelope of a line's voxels from `low` to before `high`, as seen from one side; returns its entries' number.

    They begin in `stack` where these voxels do.
    """
    count = int(0)
    site = int(0)
    start = int(0)
    height = float(0.0)
    ahead = heights[base + low * stride]
    for u in range(low, high):
        g = height_for(ahead, side)
        if u + 1 < high:
            ahead = heights[base + (u + 1) * stride]
        if g < wp.inf:
            popping = count > 0
            while popping:
                popping = cost(start, site, height, weight, half) > cost(start, u, g, weight, half)
                if popping:
                    count = count - 1
                    popping = count > 0
                    if popping:
                        entry = stack[base + (low + count - 1) * stride]
                        site = site_of(entry)
                        start = start_of(entry)
                        height = height_for(heights[base + site * stride], side)
            won = int(0)
            if count > 0:
                # Never before the one below it: costs within a rounding of each other may disagree.
                won = wp.max(first_won(site, height, u, g, weight, half), start + 1)
            if won < length:
                site = u
                start = won
                height = g
                stack[base + (low + count) * stride] = site | (start << 16)
                count = count + 1
    return count


@wp.kernel
def find_envelopes(
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
):
    """For each piece of the lines that are `far`, the envelope of its voxels; `counts` are (pieces, lines)."""
    thread = begin + wp.tid()
    piece = thread / lines
    line = thread - piece * lines
    if far[line] != 0:
        base = first_voxel(line, length, stride)
        low = first_of(piece, pieces, length)
        high = first_of(piece + 1, pieces, length)
        counts[thread] = find_envelope(heights, base, stride, length, low, high, weight, half, side, stack)
