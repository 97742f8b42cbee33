"""Caps of a mesh's boundary loops on the device, where boundary edges are many: by sorts and steps that double.

The same as `boundary_loops` finds by comparing every edge with every other: what each edge asks of the others is how
many come before it in some order, and which has a place in its loop.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.launch import LIGHT_SHARE, launch, new_zeros
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.topology.boundary_flags import TANGLED, edges_in
from sdm.kernels.topology.edge_pairing import bits_for

wp.set_module_options({"enable_backward": False})

# Behind all vertices: of an edge that is not there.
_LAST = 0x7FFFFFFF


@wp.kernel
def _take_ends(
    begin: int,
    edges: wp.array2d(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    ordered: wp.array(dtype=wp.int32),
    ends: wp.array(dtype=wp.int32),
    by_end: wp.array(dtype=wp.int32),
):
    """Keys of two sorts: vertices that edges begin and end at."""
    edge = begin + wp.tid()
    is_there = edge < edges_in(flags, edges.shape[0])
    starts[edge] = wp.where(is_there, edges[edge, 0], _LAST)
    ends[edge] = wp.where(is_there, edges[edge, 1], _LAST)
    ordered[edge] = edge
    by_end[edge] = edge


@wp.func
def _first_at(values: wp.array(dtype=wp.int32), count: int, value: int):
    """The number of values less than one, among the first `count`, which are sorted."""
    low = int(0)
    high = int(count)
    while low < high:
        middle = (low + high) / 2
        if values[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@wp.kernel
def _count_earlier(
    begin: int,
    flags: wp.array(dtype=wp.int32),
    ends: wp.array(dtype=wp.int32),
    by_end: wp.array(dtype=wp.int32),
    room: int,
    earlier: wp.array(dtype=wp.int32),
):
    """Edges that end where an edge does, and come before it."""
    place = begin + wp.tid()
    count = edges_in(flags, room)
    if place < count:
        earlier[by_end[place]] = place - _first_at(ends, count, ends[place])


@wp.kernel
def _follow(
    begin: int,
    edges: wp.array2d(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    ordered: wp.array(dtype=wp.int32),
    earlier: wp.array(dtype=wp.int32),
    ahead: wp.array(dtype=wp.int64),
    onward: wp.array(dtype=wp.int64),
    flags: wp.array(dtype=wp.int32),
):
    """Of each edge the one that follows it and its own place in the order of first vertices, in one number.

    The k-th edge that ends at a vertex is followed by the k-th that begins there.
    """
    place = begin + wp.tid()
    count = edges_in(flags, edges.shape[0])
    if place >= count:
        return
    edge = ordered[place]
    end = edges[edge, 1]
    following = _first_at(starts, count, end) + earlier[edge]
    if following >= _first_at(starts, count, end + 1):
        # The number of edges was guessed wrong.
        flags[TANGLED] = 1
        following = place
    mine = (wp.int64(ordered[following]) << wp.int64(32)) | wp.int64(place)
    ahead[edge] = mine
    onward[edge] = mine


@wp.kernel
def _look_ahead(begin: int, step: int, flags: wp.array(dtype=wp.int32), ahead: wp.array(dtype=wp.int64)):
    """Each number tells of the edges up to another one, and the least place among them: twice as many in each step.

    A number is read and written as a whole, so that it does not matter who is first.
    """
    edge = begin + wp.tid()
    count = edges_in(flags, ahead.shape[0])
    if edge >= count or (count >> step) == 0:
        return
    low = wp.int64(0x7FFFFFFF)
    mine = ahead[edge]
    theirs = ahead[int(mine >> wp.int64(32))]
    ahead[edge] = (theirs & ~low) | wp.min(mine & low, theirs & low)


@wp.kernel
def _begin_counting(
    begin: int,
    flags: wp.array(dtype=wp.int32),
    ahead: wp.array(dtype=wp.int64),
    onward: wp.array(dtype=wp.int64),
    around: wp.array(dtype=wp.int32),
):
    """A loop is known by its first place: from there no edges are left to it, from any other one, to begin with."""
    edge = begin + wp.tid()
    if edge >= edges_in(flags, around.shape[0]):
        return
    low = wp.int64(0x7FFFFFFF)
    first = int(ahead[edge] & low)
    around[edge] = first
    if int(onward[edge] & low) == first:
        onward[edge] = wp.int64(edge) << wp.int64(32)
    else:
        onward[edge] = (onward[edge] & ~low) | wp.int64(1)


@wp.kernel
def _count_onward(begin: int, step: int, flags: wp.array(dtype=wp.int32), onward: wp.array(dtype=wp.int64)):
    """Edges from each to the first of its loop."""
    edge = begin + wp.tid()
    count = edges_in(flags, onward.shape[0])
    if edge >= count or (count >> step) == 0:
        return
    low = wp.int64(0x7FFFFFFF)
    mine = onward[edge]
    theirs = onward[int(mine >> wp.int64(32))]
    onward[edge] = (theirs & ~low) | ((mine & low) + (theirs & low))


@wp.kernel
def _measure_loops(
    begin: int, flags: wp.array(dtype=wp.int32), around: wp.array(dtype=wp.int32), lengths: wp.array(dtype=wp.int32)
):
    edge = begin + wp.tid()
    if edge < edges_in(flags, around.shape[0]):
        fetch_add(lengths, around[edge], 1)


@wp.func
def _place_in_loop(behind: int, length: int, left: int):
    """The place in the list of all loops of an edge with so many left to its first."""
    return behind - length + wp.clamp(left, 0, length - 1)


@wp.kernel
def _list_loops(
    begin: int,
    flags: wp.array(dtype=wp.int32),
    around: wp.array(dtype=wp.int32),
    onward: wp.array(dtype=wp.int64),
    lengths: wp.array(dtype=wp.int32),
    behind: wp.array(dtype=wp.int32),
    listed: wp.array(dtype=wp.int32),
):
    edge = begin + wp.tid()
    if edge < edges_in(flags, around.shape[0]):
        loop = around[edge]
        listed[_place_in_loop(behind[loop], lengths[loop], int(onward[edge] & wp.int64(0x7FFFFFFF)))] = edge


@wp.kernel
def _write_caps(
    begin: int,
    edges: wp.array2d(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
    around: wp.array(dtype=wp.int32),
    onward: wp.array(dtype=wp.int64),
    lengths: wp.array(dtype=wp.int32),
    behind: wp.array(dtype=wp.int32),
    listed: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    caps: wp.array2d(dtype=wp.int32),
):
    """The cap that cuts off each edge's first vertex, see `sdm.topology.cap_triangles`."""
    edge = begin + wp.tid()
    if edge >= edges_in(flags, edges.shape[0]):
        return
    loop = around[edge]
    length = lengths[loop]
    left = int(onward[edge] & wp.int64(0x7FFFFFFF))
    step = left & (-left)
    first = starts[loop]
    caps[edge, 0] = edges[listed[_place_in_loop(behind[loop], length, left - step)], 0]
    caps[edge, 1] = edges[edge, 0]
    caps[edge, 2] = first
    if left + step < length:
        caps[edge, 2] = edges[listed[_place_in_loop(behind[loop], length, left + step)], 0]


def cap_many_loops(
    edges: wp.array, caps: wp.array, flags: wp.array, vertices: int, empty: Callable[[int, Any], wp.array]
) -> None:
    """The caps of `boundary_loops.join_edges` of the edges that `join_many_edges` has written."""
    device, room = edges.device, edges.shape[0]
    starts, ordered, ends, by_end = (empty(2 * room, wp.int32) for _ in range(4))
    earlier, around, listed, behind = (empty(room, wp.int32) for _ in range(4))
    ahead, onward = empty(room, wp.int64), empty(room, wp.int64)
    lengths = new_zeros(empty, room)
    launch(_take_ends, room, [edges, flags, starts, ordered, ends, by_end], device, smallest=LIGHT_SHARE)
    # One bit more, as those that are not there come last.
    last = min(bits_for(vertices) + 1, 31)
    wp.utils.radix_sort_pairs(starts, ordered, room, 0, last)
    wp.utils.radix_sort_pairs(ends, by_end, room, 0, last)
    launch(_count_earlier, room, [flags, ends, by_end, room, earlier], device, smallest=LIGHT_SHARE)
    launch(_follow, room, [edges, starts, ordered, earlier, ahead, onward, flags], device, smallest=LIGHT_SHARE)
    steps = room.bit_length()
    for step in range(steps):
        launch(_look_ahead, room, [step, flags, ahead], device, smallest=LIGHT_SHARE)
    launch(_begin_counting, room, [flags, ahead, onward, around], device, smallest=LIGHT_SHARE)
    for step in range(steps):
        launch(_count_onward, room, [step, flags, onward], device, smallest=LIGHT_SHARE)
    launch(_measure_loops, room, [flags, around, lengths], device, smallest=LIGHT_SHARE)
    wp.utils.array_scan(lengths, behind, inclusive=True)
    of_loops = [flags, around, onward, lengths, behind, listed]
    launch(_list_loops, room, of_loops, device, smallest=LIGHT_SHARE)
    launch(_write_caps, room, [edges, *of_loops, starts, caps], device, smallest=LIGHT_SHARE)
