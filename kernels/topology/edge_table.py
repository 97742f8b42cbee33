"""Pairing of a mesh's faces at their edges by a hash table: what `edge_pairing` finds by a sort, in three launches.

An edge is entered under its key, into the list of those with the same ends. Then each face looks through the lists of
its edges. It does not matter who comes first: what is asked of a list is its least number, and the least beyond one's
own. A list that is long is not gone through by each of its edges: the caller then has to sort.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.launch import LIGHT_SHARE, launch
from sdm.kernels.launches.arrays import array_at
from sdm.kernels.primitives.atomics import fetch_add, keep_least
from sdm.kernels.topology.edge_pairing import OUT_OF_RANGE, UNMATCHED, bits_for, direction

wp.set_module_options({"enable_backward": False})

# Edges of one list, at most, as each goes through all of it: a step takes a GPU some 0.2 us; and places of the table
# for each edge, at least, so that free ones are near: edges of closed meshes share a place with another.
MOST_ALIKE, ROOM = 4096, 1.6
_NONE = 0x7FFFFFFF
# A number of work items beyond all that there are, by far less than what counting on from there could overflow.
BEYOND = 1 << 30


@wp.func_native(
    snippet="""
    typedef unsigned long long word;
    word* table = reinterpret_cast<word*>(keys.data);
    const word wanted = word(key) + 1;
    word place = (wanted * 0x9E3779B97F4A7C15ull >> 32) & word(last);
    for (;;) {
#if defined(__CUDA_ARCH__)
        const word before = atomicCAS(table + place, word(0), wanted);
#else
        word before = 0;
        __atomic_compare_exchange_n(table + place, &before, wanted, false, __ATOMIC_RELAXED, __ATOMIC_RELAXED);
#endif
        if (before == 0 || before == wanted)
            return static_cast<int>(place);
        place = (place + 1) & word(last);
    }
"""
)
def place_of(keys: wp.array(dtype=wp.int64), key: wp.int64, last: int) -> int:
    """The place of a key in a table of `last` + 1 places, a power of two, taken if nobody has it; 0 is a free one."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return atomicExch(values.data + index, value);
#else
    return __atomic_exchange_n(values.data + index, value, __ATOMIC_ACQ_REL);
#endif
"""
)
def _exchange(values: wp.array(dtype=wp.int32), index: int, value: int) -> int:
    """Put a value in place of another, which is returned."""
    ...


@wp.kernel
def _enter(
    begin: int,
    faces: wp.array2d(dtype=wp.int32),
    bits: int,
    keys: wp.array(dtype=wp.int64),
    heads: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.int32),
    following: wp.array(dtype=wp.int32),
    first: wp.array(dtype=wp.int32),
):
    edge = begin + wp.tid()
    face = edge / 3
    start = faces[face, edge % 3]
    end = faces[face, (edge + 1) % 3]
    keep_least(first, start, face - faces.shape[0])
    place = int(-1)
    # One from a vertex to itself has no neighbour.
    if start != end:
        key = (wp.int64(wp.min(start, end)) << wp.int64(bits)) | wp.int64(wp.max(start, end))
        place = place_of(keys, key, keys.shape[0] - 1)
        # Zero is none.
        following[edge] = _exchange(heads, place, edge + 1)
    places[edge] = place


@wp.kernel
def _pair(
    begin: int,
    faces: wp.array2d(dtype=wp.int32),
    heads: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.int32),
    following: wp.array(dtype=wp.int32),
    first: wp.array(dtype=wp.int32),
    unmatched: wp.array2d(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
    neighbours: wp.array2d(dtype=wp.int32),
    most: int,
    stopped: wp.array(dtype=wp.int32),
):
    face = begin + wp.tid()
    owned = int(0)
    for k in range(3):
        edge = 3 * face + k
        place = places[edge]
        neighbour = int(-1)
        if place >= 0:
            lead = edge
            after = int(_NONE)
            balance = int(0)
            looked = int(0)
            other = heads[place] - 1
            while other >= 0 and looked < MOST_ALIKE:
                lead = wp.min(lead, other)
                if other > edge:
                    after = wp.min(after, other)
                balance = balance + direction(faces, other)
                other = following[other] - 1
                looked = looked + 1
            if other >= 0:
                flags[OUT_OF_RANGE] = 1
            # After the last comes the first.
            after = wp.where(after == _NONE, lead, after)
            if after != edge:
                neighbour = after
            if lead == edge:
                owned = owned | (8 << k)
                if balance != 0:
                    start = faces[face, k]
                    end = faces[face, (k + 1) % 3]
                    row = fetch_add(flags, UNMATCHED, 1)
                    if row >= most:
                        # All write the same.
                        for counter in range(stopped.shape[0]):
                            stopped[counter] = BEYOND
                    unmatched[row, 0] = wp.min(start, end)
                    unmatched[row, 1] = wp.max(start, end)
                    unmatched[row, 2] = balance
        neighbours[face, k] = neighbour
        if first[faces[face, k]] == face - faces.shape[0]:
            owned = owned | (1 << k)
    neighbours[face, 3] = owned


def _places_for(faces: int) -> int:
    return 1 << (int(ROOM * 3 * faces) - 1).bit_length()


def table_length(faces: int) -> int:
    """Whole numbers of 32 bits of the table for so many faces."""
    return 3 * _places_for(faces)


def pair_by_table(
    faces: wp.array,
    first: wp.array,
    flags: wp.array,
    unmatched: wp.array,
    neighbours: wp.array,
    empty: Callable[[int, Any], wp.array],
    table: wp.array | None = None,
    most: int = 0,
    stopped: wp.array | None = None,
) -> None:
    """`edge_pairing.pair_edges` of faces without a vertex out of range.

    Such a vertex is told if more than MOST_ALIKE edges have the same ends: then all else has no meaning.

    Args:
        faces: And those after it as for `pair_edges`.
        first: In the same way.
        flags: In the same way.
        unmatched: In the same way.
        neighbours: In the same way.
        empty: Allocates workspace: `empty(length, dtype)`.
        table: (table_length(F),) int32 zeros at a multiple of 8 bytes, if there are any.
        most: Unmatched edges beyond which a map of the mesh will be thrown away.
        stopped: (n) int32, the counters of work of such a map, zero: if they are more, all its items count as done.
    """
    device: Any = faces.device
    total = faces.size
    room = _places_for(faces.shape[0])
    # Keys, and where the lists begin, in one piece of memory: zero for none.
    memory: Any = table
    if table is None:
        memory = empty(room + room // 2, wp.int64)
        memory.zero_()
    keys = array_at(memory.ptr, (room,), wp.int64, device.alias)
    heads = array_at(memory.ptr + 8 * room, (room,), wp.int32, device.alias)
    places, following = empty(total, wp.int32), empty(total, wp.int32)
    entered = [faces, bits_for(first.shape[0]), keys, heads, places, following, first]
    launch(_enter, total, entered, device, smallest=LIGHT_SHARE)
    paired = [faces, heads, places, following, first, unmatched, flags, neighbours, most]
    paired.append(array_at(0, (0,), wp.int32, device.alias) if stopped is None else stopped)
    launch(_pair, faces.shape[0], paired, device, smallest=LIGHT_SHARE)
