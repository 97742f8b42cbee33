"""Order of a mesh's triangles by their keys, where they are few: each counts those before it.

A radix sort of 20,000 keys takes a GPU ten launches one after the other, of 5,000 one that keeps a single
multiprocessor busy. Here of few each compares itself with all; of more with those of its bucket, by its key's first
bits, which are counted while keys are made. Of equal keys the first face is first, as in a radix sort: the order is
the same.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import Tree, tree_of
from sdm.kernels.launch import LIGHT_SHARE, launch
from sdm.kernels.launches.arrays import array_at
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import GPU_LANES, int_from_lane, sum_of_lanes, sum_of_some

wp.set_module_options({"enable_backward": False})

# Most triangles that compare themselves with all others, and that are sorted here at all: if all were in one bucket, of
# more each would be compared with too many.
COMPARED, LARGEST = 2560, 20_481
# Bits of a key that tell its bucket.
BUCKET_BITS = 10
BUCKETS = wp.constant(1 << BUCKET_BITS)
# Numbers that are loaded at a time, as each takes long to arrive; and those of a bucket by each of the lanes of a GPU
# that share its keys: where a mesh is fine, there may be thousands of them.
AT_ONCE, OF_BUCKET = 8, 8
SHARING = 16

Counts = wp.types.vector(length=AT_ONCE, dtype=wp.int32)
KeysOfBucket = wp.types.vector(length=OF_BUCKET, dtype=wp.int64)


@wp.kernel
def _rank(
    begin: int,
    lanes: int,
    tree: Tree,
    keys: wp.array(dtype=wp.int32),
    slots: wp.array(dtype=wp.int32),
    ordered: wp.array(dtype=wp.int32),
):
    """A group of lanes for each slot. Those behind the first mesh's only fill room, and stay where they are."""
    thread = begin + wp.tid()
    lane = thread % lanes
    slot = thread / lanes
    own = tree_of(tree, 0).count
    if slot >= own:
        if lane == 0:
            ordered[slot] = slots[slot]
        return
    key = keys[slot]
    before = int(0)
    other = lane
    while other < own:
        some = Counts()
        for k in range(AT_ONCE):
            some[k] = keys[wp.min(other + k * lanes, own - 1)]
        for k in range(AT_ONCE):
            at = other + k * lanes
            if at < own and (some[k] < key or (some[k] == key and at < slot)):
                before = before + 1
        other = other + AT_ONCE * lanes
    # Small numbers, which floats hold exactly.
    before = int(sum_of_lanes(float(before)))
    if lane == 0:
        ordered[before] = slot


@wp.func
def bucket_of(key: wp.int64, bits: int):
    """The bucket of a key of so many bits."""
    return int(key >> wp.int64(bits - BUCKET_BITS))


@wp.kernel
def _begin_buckets(
    begin: int,
    lanes: int,
    counts: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
):
    """One group of lanes: where each bucket begins, and behind all of them their end; `counts` are the same after."""
    lane = (begin + wp.tid()) % lanes
    each = BUCKETS / lanes
    first = lane * each
    mine = int(0)
    for run in range(each / AT_ONCE):
        found = Counts()
        for k in range(AT_ONCE):
            found[k] = counts[first + run * AT_ONCE + k]
        for k in range(AT_ONCE):
            mine = mine + found[k]
    before = int(0)
    for other in range(lanes):
        its = int_from_lane(mine, other)
        if other < lane:
            before = before + its
    for run in range(each / AT_ONCE):
        found = Counts()
        for k in range(AT_ONCE):
            found[k] = counts[first + run * AT_ONCE + k]
        for k in range(AT_ONCE):
            bucket = first + run * AT_ONCE + k
            starts[bucket] = before
            counts[bucket] = before
            before = before + found[k]
    if lane == lanes - 1:
        starts[BUCKETS] = before


@wp.kernel
def _place(
    begin: int,
    tree: Tree,
    bits: int,
    keys: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    placed: wp.array(dtype=wp.int64),
):
    """Each key with its slot behind it, anywhere in its bucket."""
    slot = begin + wp.tid()
    if slot < tree_of(tree, 0).count:
        key = keys[slot]
        at = fetch_add(counts, bucket_of(wp.int64(key), bits), 1)
        placed[at] = (wp.int64(key) << wp.int64(32)) | wp.int64(slot)


@wp.kernel
def _rank_in_bucket(
    begin: int,
    each: int,
    tree: Tree,
    bits: int,
    starts: wp.array(dtype=wp.int32),
    placed: wp.array(dtype=wp.int64),
    slots: wp.array(dtype=wp.int32),
    ordered: wp.array(dtype=wp.int32),
):
    """`each` neighbouring lanes for each number; all of a group stay to the end."""
    thread = begin + wp.tid()
    lane = thread % each
    number = thread / each
    is_own = number < tree_of(tree, 0).count
    mine = wp.int64(0)
    first = int(0)
    before = int(0)
    if is_own:
        mine = placed[number]
        bucket = bucket_of(mine >> wp.int64(32), bits)
        first = starts[bucket]
        other = first + lane
        end = starts[bucket + 1]
        while other < end:
            some = KeysOfBucket()
            for k in range(OF_BUCKET):
                some[k] = placed[wp.min(other + k * each, end - 1)]
            for k in range(OF_BUCKET):
                if other + k * each < end and some[k] < mine:
                    before = before + 1
            other = other + OF_BUCKET * each
    # Small numbers, which floats hold exactly.
    before = int(sum_of_some(float(before), each))
    if lane == 0:
        if is_own:
            ordered[first + before] = int(mine & wp.int64(0x7FFFFFFF))
        elif number < ordered.shape[0]:
            ordered[number] = slots[number]


def is_ranked(total: int, meshes: int, fillers: bool, bits: int) -> bool:
    """True if so many triangles with keys of so many bits are sorted here.

    They are of one mesh, or of one and of `fillers`, which only fill room.
    """
    return total <= LARGEST and (meshes == 1 or fillers) and BUCKET_BITS < bits < 32


def counts_behind(keys: wp.array, total: int) -> wp.array:
    """The numbers of buckets in the memory of a radix sort of so many keys, (BUCKETS) int32, or none of few keys."""
    device: Any = keys.device
    at: Any = keys.ptr
    return array_at(
        at + 8 * (-(-total // 2)) + 8 * total, (int(BUCKETS) if total > COMPARED else 0,), wp.int32, device.alias
    )


class RankSort:
    """A sort in the memory of a radix sort.

    Args:
        keys: (2 * total) int64: to `short`, the first part of their memory, the keys are written.
        slots: (2 * total) int32, of whose first half slot i of the first mesh will hold i.
        bits: Of the keys.
        counts: (BUCKETS) int32 zeros, if there are any.

    To `counts`, if it has any entries, they are to be added by their buckets.
    """

    def __init__(self, keys: wp.array, slots: wp.array, bits: int, counts: wp.array | None = None) -> None:
        device: Any = slots.device
        self._device, self._bits, self._total = device, bits, slots.shape[0] // 2

        def part(at: int, length: int, dtype: Any) -> Any:
            return array_at(at, (length,), dtype, device.alias)

        total, buckets = self._total, BUCKETS if self._total > COMPARED else 0
        self.short = part(keys.ptr, total, wp.int32)
        self._numbers, self._ordered = part(slots.ptr, total, wp.int32), part(slots.ptr + 4 * total, total, wp.int32)
        self._placed = part(keys.ptr + 8 * (-(-total // 2)), total, wp.int64)
        own: Any = counts_behind(keys, total)
        self._starts = part(own.ptr + 4 * buckets, buckets + 1, wp.int32)
        self.counts = own if counts is None or not buckets else counts
        if buckets and counts is None:
            self.counts.zero_()

    def order(self, tree: Tree) -> wp.array:
        """The numbers in `slots` in the order of their keys."""
        device, bits, total = self._device, self._bits, self._total
        lanes = GPU_LANES if device.is_cuda else 1
        if not self.counts.shape[0]:
            inputs = [lanes, tree, self.short, self._numbers, self._ordered]
            launch(_rank, total * lanes, inputs, device, smallest=LIGHT_SHARE)
            return self._ordered
        launch(_begin_buckets, lanes, [lanes, self.counts, self._starts], device)
        inputs = [tree, bits, self.short, self.counts, self._placed]
        launch(_place, total, inputs, device, smallest=LIGHT_SHARE)
        each = SHARING if device.is_cuda else 1
        inputs = [each, tree, bits, self._starts, self._placed, self._numbers, self._ordered]
        # Whole groups.
        launch(_rank_in_bucket, -(-total * each // lanes) * lanes, inputs, device, smallest=LIGHT_SHARE)
        return self._ordered
