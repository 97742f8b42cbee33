"""First pass of the distance transform of many classes: along the rows, which are contiguous in memory.

A row without a class is left alone and noted, so that a small class costs little. A voxel's distance to what is not of
its own class needs no class: it is that to the nearest voxel with another label, one row for all.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.edt.pass1_rows import NOWHERE, first_at_or_after, last_at_or_before, step_cost
from sdm.kernels.primitives.lanes import ballot

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


@wp.kernel
def nearest_of_class(
    begin: int,
    labels: wp.array(dtype=wp.uint8),
    first_value: int,
    rows: int,
    rows_of_slice: int,
    length: int,
    lanes: int,
    weight: float,
    half: float,
    row_has: wp.array(dtype=wp.int32),
    slice_has: wp.array(dtype=wp.int32),
    out: wp.array(dtype=wp.float32),
):
    """For each class and row that has it, squared distances (classes,rows,length) in the row to its nearest voxel.

    Classes have the values from `first_value` on. `row_has` says which rows have them,
    `slice_has`, zeros before, which slices along x.
    """
    thread = begin + wp.tid()
    group = thread / lanes
    lane = thread - group * lanes
    kind = group / rows
    value = first_value + kind
    base = (group - kind * rows) * length
    target = group * length
    words = (length + lanes - 1) / lanes
    there = wp.uint32(0)
    for word in range(words):
        k = word * lanes + lane
        found = bool(False)
        if k < length:
            found = int(labels[base + k]) == value
        there = there | ballot(found)
    if lane == 0:
        row_has[group] = int(there != wp.uint32(0))
        if there != wp.uint32(0):
            slice_has[group / rows_of_slice] = 1
    if there == wp.uint32(0):
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
