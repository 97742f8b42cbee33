"""First pass of the distance transform: along the axis that is contiguous in memory.

A group of lanes reads a row word by word, one voxel a lane, and finds the nearest voxel of the other class from the
word's bits; what lies before or after the word is carried along.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.edt.short_range import Marks, mark
from sdm.kernels.primitives.lanes import ballot

wp.set_module_options({"enable_backward": False})

NOWHERE = 1 << 28


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return 31 - __clz(bits & ((2u << lane) - 1u));
#else
    return bits ? 0 : -1;
#endif
"""
)
def last_at_or_before(bits: wp.uint32, lane: int) -> int:
    """The last lane up to `lane` whose bit is set, or -1."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __ffs(bits & ~((1u << lane) - 1u)) - 1;
#else
    return bits ? 0 : -1;
#endif
"""
)
def first_at_or_after(bits: wp.uint32, lane: int) -> int:
    """The first lane from `lane` on whose bit is set, or -1."""
    ...


@wp.func
def step_cost(steps: int, weight: float, half: float):
    """Squared distance along one axis between voxels that are `steps` > 0 apart."""
    away = float(steps) - half
    return weight * (away * away)


@wp.kernel
def nearest_in_row(
    begin: int,
    mask: wp.array(dtype=wp.uint8),
    length: int,
    lanes: int,
    weight: float,
    half: float,
    both: int,
    following: Marks,
    across: int,
    out: wp.array(dtype=wp.float32),
):
    """Squared distance to the nearest voxel of the other class in the same row; see `edt.transform`.

    The lines of the next pass are marked in `following`; `across` rows side by side have the same ones.
    """
    thread = begin + wp.tid()
    row = thread / lanes
    lane = thread - row * lanes
    base = row * length
    words = (length + lanes - 1) / lanes
    before_inside = int(-NOWHERE)
    before_outside = int(-NOWHERE)
    for word in range(words):
        k = word * lanes + lane
        there = k < length
        inside = bool(False)
        if there:
            inside = mask[base + k] != wp.uint8(0)
        insides = ballot(inside)
        outsides = ballot(there and not inside)
        nearest = int(before_inside)
        bits = wp.uint32(insides)
        if inside:
            nearest = int(before_outside)
            bits = wp.uint32(outsides)
        found = last_at_or_before(bits, lane)
        if found >= 0:
            nearest = word * lanes + found
        if there:
            # The distance in steps, for now; the way back completes it.
            out[base + k] = float(wp.min(k - nearest, NOWHERE))
        found = last_at_or_before(insides, lanes - 1)
        if found >= 0:
            before_inside = word * lanes + found
        found = last_at_or_before(outsides, lanes - 1)
        if found >= 0:
            before_outside = word * lanes + found
    after_inside = int(NOWHERE + NOWHERE)
    after_outside = int(NOWHERE + NOWHERE)
    for back in range(words):
        word = words - 1 - back
        k = word * lanes + lane
        there = k < length
        inside = bool(False)
        if there:
            inside = mask[base + k] != wp.uint8(0)
        insides = ballot(inside)
        outsides = ballot(there and not inside)
        nearest = int(after_inside)
        bits = wp.uint32(insides)
        if inside:
            nearest = int(after_outside)
            bits = wp.uint32(outsides)
        found = first_at_or_after(bits, lane)
        if found >= 0:
            nearest = word * lanes + found
        if there:
            steps = wp.min(int(out[base + k]), nearest - k)
            value = float(wp.inf)
            if steps < NOWHERE / 2:
                value = step_cost(steps, weight, half)
            if inside:
                value = -value
                if both == 0:
                    value = 0.0
            mark(following, row / across * length + k, value)
            out[base + k] = value
        found = first_at_or_after(insides, 0)
        if found >= 0:
            after_inside = word * lanes + found
        found = first_at_or_after(outsides, 0)
        if found >= 0:
            after_outside = word * lanes + found
