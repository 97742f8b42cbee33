"""Boundary edges on the device, where many edges are unmatched: by two hash tables and a sort.

The same as `boundary_loops` finds by comparing every edge with every other. Ends are entered under their positions,
then rows under the vertices that their ends count as, and those that are left are sorted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.launch import LIGHT_SHARE, launch
from sdm.kernels.launches.arrays import array_at
from sdm.kernels.primitives.atomics import fetch_add, keep_least
from sdm.kernels.topology.boundary_flags import ALL_EDGES, ALL_UNMATCHED, WRONG_EDGES, WRONG_UNMATCHED, WRONG_VERTEX
from sdm.kernels.topology.edge_pairing import OUT_OF_RANGE, UNMATCHED, bits_for
from sdm.kernels.topology.edge_table import place_of
from sdm.kernels.topology.ends_at_one_place import end_of, rows_of

wp.set_module_options({"enable_backward": False})


@wp.func_native(
    snippet="""
    unsigned int bits[3];
    for (int k = 0; k < 3; ++k) {
        // -0 and +0 are one place.
        const float x = at[k] + 0.0f;
        memcpy(bits + k, &x, 4);
    }
    unsigned int hash = bits[0] * 0x9E3779B1u ^ bits[1] * 0x85EBCA77u ^ bits[2] * 0xC2B2AE3Du;
    hash ^= hash >> 15;
    hash *= 0x2C1B3C6Du;
    hash ^= hash >> 13;
    return static_cast<int>(hash & 0x7FFFFFFFu);
"""
)
def _hash_of(at: wp.vec3) -> int:
    """A number of a position, the same for equal ones."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return atomicCAS(places.data + index, 0, value);
#else
    int before = 0;
    __atomic_compare_exchange_n(places.data + index, &before, value, false, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE);
    return before;
#endif
"""
)
def _take_place(places: wp.array(dtype=wp.int32), index: int, value: int) -> int:
    """Put a value where zero is; returns what was there."""
    ...


@wp.func
def _are_at_one_place(vertices: wp.array2d(dtype=wp.vec3), a: int, b: int):
    equal = bool(True)
    for mesh in range(vertices.shape[0]):
        equal = equal and vertices[mesh, a] == vertices[mesh, b]
    return equal


@wp.kernel
def _enter_ends(
    begin: int,
    unmatched: wp.array2d(dtype=wp.int32),
    vertices: wp.array2d(dtype=wp.vec3),
    found: wp.array(dtype=wp.int32),
    table: wp.array(dtype=wp.int32),
    least: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.int32),
):
    """Enter each end under its position, and note the lowest vertex there, as its difference from all."""
    end = begin + wp.tid()
    if end >= 2 * rows_of(found, unmatched.shape[0]):
        return
    count = vertices.shape[1]
    vertex = end_of(unmatched, end, count)
    last = table.shape[0] - 1
    place = _hash_of(vertices[0, vertex]) & last
    before = _take_place(table, place, end + 1)
    while before != 0 and not _are_at_one_place(vertices, end_of(unmatched, before - 1, count), vertex):
        place = (place + 1) & last
        before = _take_place(table, place, end + 1)
    places[end] = place
    keep_least(least, place, vertex - count)


@wp.kernel
def _enter_edges(
    begin: int,
    bits: int,
    unmatched: wp.array2d(dtype=wp.int32),
    vertices: int,
    found: wp.array(dtype=wp.int32),
    least: wp.array(dtype=wp.int32),
    ends_at: wp.array(dtype=wp.int32),
    table: wp.array(dtype=wp.int64),
    balances: wp.array(dtype=wp.int32),
    firsts: wp.array(dtype=wp.int32),
    keys: wp.array(dtype=wp.int64),
    places: wp.array(dtype=wp.int32),
):
    """Enter each row under the vertices that its ends count as, add up edges there, and note the first of the rows."""
    row = begin + wp.tid()
    if row >= rows_of(found, unmatched.shape[0]):
        return
    start = least[ends_at[2 * row]] + vertices
    end = least[ends_at[2 * row + 1]] + vertices
    key = (wp.int64(wp.min(start, end)) << wp.int64(bits)) | wp.int64(wp.max(start, end))
    place = int(-1)
    if start != end:
        place = place_of(table, key, table.shape[0] - 1)
        fetch_add(balances, place, wp.sign(end - start) * unmatched[row, 2])
        keep_least(firsts, place, row - unmatched.shape[0])
    keys[row] = key
    places[row] = place


@wp.kernel
def _order_edges(
    begin: int,
    unmatched: wp.array2d(dtype=wp.int32),
    found: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.int32),
    sums: wp.array(dtype=wp.int32),
    firsts: wp.array(dtype=wp.int32),
    keys: wp.array(dtype=wp.int64),
    order: wp.array(dtype=wp.int32),
    balances: wp.array(dtype=wp.int32),
    guessed: int,
    flags: wp.array(dtype=wp.int32),
):
    """Net count of all edges between the same two vertices, at the first of them; zero at others, which come last."""
    row = begin + wp.tid()
    rows = unmatched.shape[0]
    if row == 0:
        more = found[UNMATCHED] - rows
        flags[WRONG_VERTEX] = flags[WRONG_VERTEX] | found[OUT_OF_RANGE]
        flags[ALL_UNMATCHED] = found[UNMATCHED]
        flags[WRONG_UNMATCHED] = wp.where(guessed != 0, more, wp.max(more, 0))
    balance = int(0)
    if row < rows_of(found, rows) and places[row] >= 0 and firsts[places[row]] + rows == row:
        balance = sums[places[row]]
    if balance == 0:
        keys[row] = ~(wp.int64(1) << wp.int64(63))
    balances[row] = balance
    order[row] = row


@wp.kernel
def _count_edges(
    begin: int,
    order: wp.array(dtype=wp.int32),
    balances: wp.array(dtype=wp.int32),
    numbers: wp.array(dtype=wp.int32),
):
    place = begin + wp.tid()
    numbers[place] = wp.abs(balances[order[place]])


@wp.kernel
def _write_edges(
    begin: int,
    bits: int,
    keys: wp.array(dtype=wp.int64),
    order: wp.array(dtype=wp.int32),
    balances: wp.array(dtype=wp.int32),
    numbers: wp.array(dtype=wp.int32),
    behind: wp.array(dtype=wp.int32),
    guessed: int,
    edges: wp.array2d(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
):
    place = begin + wp.tid()
    room = edges.shape[0]
    if place == numbers.shape[0] - 1:
        flags[ALL_EDGES] = behind[place]
        more = behind[place] - room
        flags[WRONG_EDGES] = wp.where(guessed != 0, more, wp.max(more, 0))
    number = numbers[place]
    if number == 0:
        return
    low = int(keys[place] >> wp.int64(bits))
    high = int(keys[place] & ((wp.int64(1) << wp.int64(bits)) - wp.int64(1)))
    leads_up = balances[order[place]] > 0
    for i in range(behind[place] - number, wp.min(behind[place], room)):
        edges[i, 0] = wp.where(leads_up, low, high)
        edges[i, 1] = wp.where(leads_up, high, low)


def _table_length(entries: int) -> int:
    """Places of a table for so many, half of them free at least: a power of two."""
    return 1 << (2 * entries - 1).bit_length()


def join_many_edges(
    unmatched: wp.array,
    found: wp.array,
    vertices: wp.array,
    edges: wp.array,
    flags: wp.array,
    empty: Callable[[int, Any], wp.array],
    in_room: bool,
) -> None:
    """The boundary edges of `boundary_loops.join_edges`, whose arguments these are."""
    device: Any = vertices.device
    rows, count = unmatched.shape[0], vertices.shape[1]
    bits, guessed = bits_for(count), int(not in_room)
    places, places_of_edges = _table_length(2 * rows), _table_length(rows)
    # Tables that begin with zeros, in one piece of memory.
    memory: Any = empty(places_of_edges + places + places_of_edges, wp.int64)
    memory.zero_()
    table = array_at(memory.ptr, (places_of_edges,), wp.int64, device.alias)
    at = memory.ptr + 8 * places_of_edges
    taken, least = (array_at(at + 4 * k * places, (places,), wp.int32, device.alias) for k in range(2))
    at += 8 * places
    sums, firsts = (
        array_at(at + 4 * k * places_of_edges, (places_of_edges,), wp.int32, device.alias) for k in range(2)
    )
    ends_at, of_edges, balances = empty(2 * rows, wp.int32), empty(rows, wp.int32), empty(rows, wp.int32)
    keys, order = empty(2 * rows, wp.int64), empty(2 * rows, wp.int32)
    numbers, behind = empty(rows, wp.int32), empty(rows, wp.int32)
    entered = [unmatched, vertices, found, taken, least, ends_at]
    launch(_enter_ends, 2 * rows, entered, device, smallest=LIGHT_SHARE)
    entered = [bits, unmatched, count, found, least, ends_at, table, sums, firsts, keys, of_edges]
    launch(_enter_edges, rows, entered, device, smallest=LIGHT_SHARE)
    summed = [unmatched, found, of_edges, sums, firsts, keys, order, balances, guessed, flags]
    launch(_order_edges, rows, summed, device, smallest=LIGHT_SHARE)
    # One bit more, as rows without edges come last.
    wp.utils.radix_sort_pairs(keys, order, rows, 0, min(2 * bits + 1, 64))
    launch(_count_edges, rows, [order, balances, numbers], device, smallest=LIGHT_SHARE)
    wp.utils.array_scan(numbers, behind, inclusive=True)
    written = [bits, keys, order, balances, numbers, behind, guessed, edges, flags]
    launch(_write_edges, rows, written, device, smallest=LIGHT_SHARE)
