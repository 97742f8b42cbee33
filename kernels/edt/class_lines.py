"""Later passes of the distance transform of many classes: lower envelopes, which need no memory of their own.

A thread has a line. It goes through the line's voxels from the last to the first and keeps those that are nearest
somewhere, each with the place before which it is (`end`); then through the places from the first to the last. The
envelope lies in the line's own results: at the end of the line, the entry for the first places first, so that the
entries still to come, of which each has a place, lie behind the place that is written.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.edt.envelopes import first_won, site_of
from sdm.kernels.edt.short_range import cost, finished, first_voxel

wp.set_module_options({"enable_backward": False})


@wp.func
def end_of(entry: int):
    """The place before which the voxel that an envelope's entry names is the nearest."""
    return entry >> 16


@wp.func
def height_between(heights: wp.array(dtype=wp.float32), base: int, stride: int, low: int, high: int, site: int):
    """A site's height; what borders on the places from `low` to before `high` is at zero."""
    height = float(0.0)
    if site >= low and site < high:
        height = heights[base + site * stride]
    return height


@wp.func
def entry_at(out: wp.array(dtype=wp.float32), at: int):
    """An envelope's entry, whose bits lie in the memory of results."""
    return wp.cast(out[at], wp.int32)


@wp.func
def part_of(ends: wp.array(dtype=wp.int32), kind: int, length: int):
    """First place of a line that has a class, and the one after the last; (length, 0) where there is none."""
    return length + ends[2 * kind], -ends[2 * kind + 1]


@wp.func
def height_above(
    heights: wp.array(dtype=wp.float32),
    has: wp.array(dtype=wp.int32),
    first: int,
    step: int,
    base: int,
    stride: int,
    low: int,
    high: int,
    site: int,
):
    """`height_between`, infinite where there is none: where `first` is not below zero and `has` is zero."""
    if first >= 0:
        if has[first + site * step] == 0:
            return float(wp.inf)
    return height_between(heights, base, stride, low, high, site)


@wp.func
def write_place(
    x: int,
    squared: float,
    base: int,
    stride: int,
    scale: float,
    missing: float,
    own: wp.array(dtype=wp.float32),
    own_base: int,
    out: wp.array(dtype=wp.float32),
):
    """Write what a place at this squared distance gets, see `fill_places`."""
    value = finished(squared, scale, missing)
    if squared == 0.0 and own_base >= 0:
        value = -own[own_base + x * stride]
    out[base + x * stride] = value


@wp.func
def fill_places(
    heights: wp.array(dtype=wp.float32),
    has: wp.array(dtype=wp.int32),
    first: int,
    step: int,
    base: int,
    stride: int,
    low: int,
    high: int,
    low_site: int,
    high_site: int,
    weight: float,
    half: float,
    scale: float,
    missing: float,
    own: wp.array(dtype=wp.float32),
    own_base: int,
    out: wp.array(dtype=wp.float32),
):
    """Distances of the places from `low` to before `high`, by the sites from `low_site` to `high_site` - 1.

    Sites whose `has`, from `first` on, each `step` further, is zero have no height; all have where `first` is below
    zero. Squared distances where `scale` is zero; zeros become minus what `own` has, from `own_base` on, unless that is
    below zero.
    """
    count = int(0)
    site = int(0)
    height = float(0.0)
    end = int(0)
    ahead = float(wp.inf)
    if low_site < high_site:
        ahead = height_above(heights, has, first, step, base, stride, low, high, high_site - 1)
    for back in range(high_site - low_site):
        u = high_site - 1 - back
        g = ahead
        if u > low_site:
            # Read before it is needed: this takes a GPU as long as all that follows.
            ahead = height_above(heights, has, first, step, base, stride, low, high, u - 1)
        if g < wp.inf:
            popping = count > 0
            while popping:
                popping = cost(end - 1, u, g, weight, half) < cost(end - 1, site, height, weight, half)
                if popping:
                    count = count - 1
                    popping = count > 0
                    if popping:
                        entry = entry_at(out, base + (high - count) * stride)
                        site = site_of(entry)
                        end = end_of(entry)
                        height = height_between(heights, base, stride, low, high, site)
            until = int(high)
            if count > 0:
                # Never beyond what is left: costs within a rounding of each other may disagree.
                until = wp.min(first_won(u, g, site, height, weight, half), end - 1)
            if until > low:
                site = u
                end = until
                height = g
                count = count + 1
                out[base + (high - count) * stride] = wp.cast(site | (end << 16), wp.float32)
    if count == 0:
        for x in range(low, high):
            out[base + x * stride] = finished(wp.inf, scale, missing)
        return
    at = int(high - count)
    for x in range(low, high):
        if x == end:
            at = at + 1
            entry = entry_at(out, base + at * stride)
            site = site_of(entry)
            end = end_of(entry)
            height = height_between(heights, base, stride, low, high, site)
        squared = cost(x, site, height, weight, half)
        write_place(x, squared, base, stride, scale, missing, own, own_base, out)


@wp.kernel
def nearest_of_class_on_line(
    begin: int,
    heights: wp.array(dtype=wp.float32),
    has: wp.array(dtype=wp.int32),
    step: int,
    ends: wp.array(dtype=wp.int32),
    length: int,
    stride: int,
    weight: float,
    half: float,
    scale: float,
    missing: float,
    has_sides: int,
    own: wp.array(dtype=wp.float32),
    out: wp.array(dtype=wp.float32),
):
    """Distances along the lines of each class: squared without a `scale`, with `has_sides` those of `own` inside.

    `has`, (lines / stride, length, step), says where heights are, and `ends` (lines / stride, 2) between which places
    (see `part_of`). Without a scale, lines without heights are left alone.
    """
    line = begin + wp.tid()
    outer = line / stride
    first, after = part_of(ends, outer, length)
    if scale > 0.0 or first < after:
        base = first_voxel(line, length, stride)
        own_base = int(-1)
        if has_sides != 0:
            own_base = line - outer * stride
        fill_places(
            heights,
            has,
            outer * length * step,
            step,
            base,
            stride,
            0,
            length,
            first,
            after,
            weight,
            half,
            scale,
            missing,
            own,
            own_base,
            out,
        )


@wp.kernel
def nearest_other_label_on_line(
    begin: int,
    labels: wp.array(dtype=wp.uint8),
    first_value: int,
    kinds: int,
    heights: wp.array(dtype=wp.float32),
    unread: wp.array(dtype=wp.int32),
    length: int,
    stride: int,
    weight: float,
    half: float,
    scale: float,
    missing: float,
    out: wp.array(dtype=wp.float32),
):
    """Along each line the distances to other labels: of every run of equal labels by its own voxels and its two ends.

    Of the `kinds` labels from `first_value` on; those of others are left alone. Squared without a `scale`.
    """
    line = begin + wp.tid()
    base = first_voxel(line, length, stride)
    low = int(0)
    while low < length:
        label = labels[base + low * stride]
        high = int(low + 1)
        going = high < length
        while going:
            going = labels[base + high * stride] == label
            if going:
                high = high + 1
                going = high < length
        if int(label) >= first_value and int(label) < first_value + kinds:
            fill_places(
                heights,
                unread,
                -1,
                0,
                base,
                stride,
                low,
                high,
                wp.max(low - 1, 0),
                wp.min(high + 1, length),
                weight,
                half,
                scale,
                missing,
                heights,
                -1,
                out,
            )
        low = high
