"""First pass of the distance transform of many classes: along the rows, which are contiguous in memory.

A group of lanes has a row and fills those of the classes that are in it, so that a small class costs little. A voxel's
distance to what is not of its own class needs no class: it is that to the nearest voxel with another label, one row for
all.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.edt.pass1_rows import NOWHERE, first_at_or_after, last_at_or_before, step_cost
from sdm.kernels.primitives.atomics import fetch_least, keep_least
from sdm.kernels.primitives.lanes import ballot, first_member, int_from_lane

wp.set_module_options({"enable_backward": False})


@wp.func
def height_of(steps: int, weight: float, half: float):
    """Squared distance of a voxel that is so many steps from a site in its row; infinite from nowhere."""
    value = float(wp.inf)
    if steps == 0:
        value = 0.0
    elif steps < NOWHERE / 2:
        value = step_cost(steps, weight, half)
    return value


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __ffs(bits & ~((2u << lane) - 1u)) - 1;
#else
    return -1;
#endif
"""
)
def first_after(bits: wp.uint32, lane: int) -> int:
    """The first lane after `lane` whose bit is set, or -1."""
    ...


@wp.func
def write_row(
    kept: wp.uint32,
    more: int,
    length: int,
    lane: int,
    lanes: int,
    weight: float,
    half: float,
    out: wp.array(dtype=wp.float32),
    target: int,
):
    """Squared distances in a row of no more words than lanes, each of which has `kept` the sites of one, as bits.

    To sites before a voxel there are `more` steps.
    """
    words = (length + lanes - 1) / lanes
    filled = ballot(kept != wp.uint32(0))
    before = int(-NOWHERE)
    for word in range(words):
        k = word * lanes + lane
        bits = wp.uint32(int_from_lane(int(kept), word))
        other = first_after(filled, word)
        beyond = wp.uint32(int_from_lane(int(kept), wp.max(other, 0)))
        after = int(NOWHERE + NOWHERE)
        if other >= 0:
            after = other * lanes + first_member(beyond)
        last = last_at_or_before(bits, lane)
        following = first_after(bits, lane)
        back = k + more - wp.where(last >= 0, word * lanes + last, before)
        steps = wp.min(wp.min(back, NOWHERE), wp.where(following >= 0, word * lanes + following, after) - k)
        if k < length:
            out[target + k] = height_of(steps, weight, half)
        last = last_at_or_before(bits, lanes - 1)
        if last >= 0:
            before = word * lanes + last


@wp.func
def fill_row(
    labels: wp.array(dtype=wp.uint8),
    base: int,
    value: int,
    length: int,
    lane: int,
    lanes: int,
    weight: float,
    half: float,
    out: wp.array(dtype=wp.float32),
    target: int,
):
    """Squared distances in the row of labels from `base` on to its nearest voxel of a value, from `out[target]` on."""
    words = (length + lanes - 1) / lanes
    if words <= lanes:
        kept = wp.uint32(0)
        for word in range(words):
            k = word * lanes + lane
            found = bool(False)
            if k < length:
                found = int(labels[base + k]) == value
            bits = ballot(found)
            if lane == word:
                kept = bits
        write_row(kept, 0, length, lane, lanes, weight, half, out, target)
        return
    before = int(-NOWHERE)
    for word in range(words):
        k = word * lanes + lane
        here = bool(False)
        if k < length:
            here = int(labels[base + k]) == value
        bits = ballot(here)
        site = last_at_or_before(bits, lane)
        if k < length:
            # The distance in steps, for now; the way back completes it.
            out[target + k] = float(wp.min(k - wp.where(site >= 0, word * lanes + site, before), NOWHERE))
        last = last_at_or_before(bits, lanes - 1)
        if last >= 0:
            before = word * lanes + last
    after = int(NOWHERE + NOWHERE)
    for back in range(words):
        word = words - 1 - back
        k = word * lanes + lane
        here = bool(False)
        if k < length:
            here = int(labels[base + k]) == value
        bits = ballot(here)
        site = first_at_or_after(bits, lane)
        if k < length:
            steps = wp.min(int(out[target + k]), wp.where(site >= 0, word * lanes + site, after) - k)
            out[target + k] = height_of(steps, weight, half)
        first = first_at_or_after(bits, 0)
        if first >= 0:
            after = word * lanes + first


@wp.func
def stretch(ends: wp.array(dtype=wp.int32), kind: int, place: int, length: int):
    """Bring a place into the part of a line that `ends`, zeros before, has for a class; True if it is the first one."""
    before = fetch_least(ends, 2 * kind, place - length)
    keep_least(ends, 2 * kind + 1, -(place + 1))
    return before == 0


@wp.kernel
def nearest_of_classes(
    begin: int,
    labels: wp.array(dtype=wp.uint8),
    first_value: int,
    kinds: int,
    rows: int,
    rows_of_slice: int,
    length: int,
    lanes: int,
    weight: float,
    half: float,
    row_has: wp.array(dtype=wp.int32),
    row_ends: wp.array(dtype=wp.int32),
    slice_ends: wp.array(dtype=wp.int32),
    out: wp.array(dtype=wp.float32),
):
    """For each class and row that has it, squared distances (kinds,rows,length) in the row to its nearest voxel.

    Classes have the values from `first_value` on. `row_has` (kinds,rows) says which rows have them; of each class
    `row_ends` the part of the rows of each slice along x that has it, and `slice_ends` that of the slices (see
    `class_lines.part_of`). All three are zeros before.
    """
    thread = begin + wp.tid()
    row = thread / lanes
    lane = thread - row * lanes
    base = row * length
    slices = rows / rows_of_slice
    layer = row / rows_of_slice
    across = row - layer * rows_of_slice
    words = (length + lanes - 1) / lanes
    latest = int(-1)
    for word in range(words):
        k = word * lanes + lane
        kind = int(-1)
        if k < length:
            kind = int(labels[base + k]) - first_value
        left = ballot(kind >= 0 and kind < kinds and kind != latest)
        while left != wp.uint32(0):
            latest = int_from_lane(kind, first_member(left))
            left = left & ~ballot(kind == latest)
            place = latest * rows + row
            seen = int(0)
            if lane == 0:
                seen = row_has[place]
                if seen == 0:
                    row_has[place] = 1
                    if stretch(row_ends, latest * slices + layer, across, rows_of_slice):
                        stretch(slice_ends, latest, layer, slices)
            if int_from_lane(seen, 0) == 0:
                fill_row(labels, base, first_value + latest, length, lane, lanes, weight, half, out, place * length)


@wp.kernel
def nearest_other_label(
    begin: int,
    labels: wp.array(dtype=wp.uint8),
    length: int,
    lanes: int,
    weight: float,
    half: float,
    out: wp.array(dtype=wp.float32),
):
    """Squared distance of each voxel in its row to the nearest one with another label."""
    thread = begin + wp.tid()
    row = thread / lanes
    lane = thread - row * lanes
    base = row * length
    words = (length + lanes - 1) / lanes
    if words <= lanes:
        kept = wp.uint32(0)
        for word in range(words):
            k = word * lanes + lane
            found = bool(False)
            if k > 0 and k < length:
                found = labels[base + k] != labels[base + k - 1]
            bits = ballot(found)
            if lane == word:
                kept = bits
        write_row(kept, 1, length, lane, lanes, weight, half, out, base)
        return
    before = int(-NOWHERE)
    for word in range(words):
        k = word * lanes + lane
        # Where a run of equal labels begins the voxel before is another's.
        begins = bool(False)
        if k > 0 and k < length:
            begins = labels[base + k] != labels[base + k - 1]
        bits = ballot(begins)
        site = last_at_or_before(bits, lane)
        if k < length:
            out[base + k] = float(wp.min(k + 1 - wp.where(site >= 0, word * lanes + site, before), NOWHERE))
        last = last_at_or_before(bits, lanes - 1)
        if last >= 0:
            before = word * lanes + last
    after = int(NOWHERE + NOWHERE)
    for back in range(words):
        word = words - 1 - back
        k = word * lanes + lane
        ends = bool(False)
        if k + 1 < length:
            ends = labels[base + k] != labels[base + k + 1]
        bits = ballot(ends)
        site = first_at_or_after(bits, lane)
        if k < length:
            steps = wp.min(int(out[base + k]), wp.where(site >= 0, word * lanes + site, after) + 1 - k)
            out[base + k] = height_of(steps, weight, half)
        first = first_at_or_after(bits, 0)
        if first >= 0:
            after = word * lanes + first
