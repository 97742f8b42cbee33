"""Later passes of the distance transform of many classes on a GPU: bundles of lines, which need no envelopes.

What they find is what `class_lines` finds.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.edt.class_lines import part_of
from sdm.kernels.edt.line_bundles import (
    greatest_at,
    has_gaps,
    is_soon,
    least_at,
    least_of_class,
    least_of_others,
    nearest_of_class,
    nearest_of_others,
    places_with,
    write_places,
)
from sdm.kernels.primitives.lanes import ballot, unknown

wp.set_module_options({"enable_backward": False})


@wp.kernel
def nearest_of_class_in_bundle(
    begin: int,
    heights: wp.array(dtype=wp.float32),
    has: wp.array(dtype=wp.int32),
    step: int,
    ends: wp.array(dtype=wp.int32),
    length: int,
    stride: int,
    bundles: int,
    lanes: int,
    weight: float,
    half: float,
    scale: float,
    missing: float,
    has_sides: int,
    own: wp.array(dtype=wp.float32),
    out: wp.array(dtype=wp.float32),
):
    """`class_lines.nearest_of_class_on_line` by `lanes` together, of which each has a line of a bundle.

    There are `bundles` of them side by side in a stride.
    """
    thread = begin + wp.tid()
    bundle = thread / lanes
    outer = bundle / bundles
    column = (bundle - outer * bundles) * lanes + thread - bundle * lanes
    # Lanes beyond the last line look at that one.
    there = column < stride
    column = wp.min(column, stride - 1)
    base = outer * stride * length + column
    sites = outer * length * step
    first, after = part_of(ends, outer, length)
    if first >= after:
        if scale > 0.0 and there:
            for x in range(length):
                out[base + x * stride] = missing
        return
    own_base = int(-1)
    if has_sides != 0:
        own_base = column
    gaps = has_gaps(has, sites, step, first, after - 1)
    low = int(first)
    far = int(0)
    while far < length:
        farther = nearest_of_class(
            heights, base, stride, has, sites, step, gaps, low, after - 1, far + 63, 64, weight, half
        )
        for j in range(unknown(8)):
            part = far + 64 * j
            if part < length:
                high = greatest_at(farther, j)
                near = nearest_of_class(
                    heights, base, stride, has, sites, step, gaps, low, high, part + 7, 8, weight, half
                )
                for i in range(unknown(8)):
                    x = part + 8 * i
                    if x < length:
                        high = greatest_at(near, i)
                        best = least_of_class(
                            heights, base, stride, has, sites, step, gaps, low, high, x, 1, weight, half
                        )
                        wanted = wp.where(there, 255 >> wp.max(x + 8 - length, 0), 0)
                        write_places(best, wanted, x, base, stride, scale, missing, own, own_base, out)
                        low = least_at(near, i)
        far = far + 512


@wp.kernel
def nearest_other_label_in_bundle(
    begin: int,
    labels: wp.array(dtype=wp.uint8),
    first_value: int,
    heights: wp.array(dtype=wp.float32),
    ends: wp.array(dtype=wp.int32),
    outers: int,
    length: int,
    stride: int,
    bundles: int,
    lanes: int,
    weight: float,
    half: float,
    scale: float,
    missing: float,
    out: wp.array(dtype=wp.float32),
):
    """`class_lines.nearest_other_label_on_line` by `lanes` together, of which each has a line of a bundle.

    Each label, from `first_value` on, has groups of its own, for all `outers` times `bundles` bundles; `ends` (labels *
    outers, 2) say between which places it is. Heights are read where it is.
    """
    thread = begin + wp.tid()
    bundle = thread / lanes
    outer = bundle / bundles
    column = (bundle - outer * bundles) * lanes + thread - bundle * lanes
    there = column < stride
    column = wp.min(column, stride - 1)
    kind = outer / outers
    value = wp.uint8(first_value + kind)
    base = (outer - kind * outers) * stride * length + column
    first, after = part_of(ends, outer, length)
    far = int(first)
    going = far < after
    while going:
        going = ballot(is_soon(labels, base, stride, far, after, value)) == wp.uint32(0)
        if going:
            far = far + 16
            going = far < after
    going = far < after
    while going:
        going = ballot(places_with(labels, base, stride, far, after, value) != 0) == wp.uint32(0)
        if going:
            far = far + 8
            going = far < after
    low = wp.max(far - 1, 0)
    last = wp.min(after, length - 1)
    while far < after:
        farther = nearest_of_others(heights, base, stride, labels, value, low, last, far + 63, 64, weight, half)
        for j in range(unknown(8)):
            part = far + 64 * j
            if part < after:
                high = greatest_at(farther, j)
                near = nearest_of_others(heights, base, stride, labels, value, low, high, part + 7, 8, weight, half)
                for i in range(unknown(8)):
                    x = part + 8 * i
                    if x < after:
                        high = greatest_at(near, i)
                        bits = places_with(labels, base, stride, x, after, value)
                        if ballot(bits != 0) != wp.uint32(0):
                            best = least_of_others(heights, base, stride, labels, value, low, high, x, 1, weight, half)
                            if not there:
                                bits = int(0)
                            write_places(best, bits, x, base, stride, scale, missing, heights, -1, out)
                        low = least_at(near, i)
        far = far + 512
