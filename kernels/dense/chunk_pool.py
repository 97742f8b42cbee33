"""Chunk pool: candidate lists as chains of chunks, as nobody knows their lengths before.

Whoever finds the pool empty is marked, and its voxels are searched one by one later: slower, never wrong. Where boxes
are few, each list is made by several groups of lanes, of one share of the tree each: a chain for each.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.dense.counters import NEXT_CHUNK
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.lanes import ballot, members, rank

wp.set_module_options({"enable_backward": False})

CHUNK = 64
ROOM = 63  # entries of a chunk; the last place names the next chunk


@wp.struct
class ChunkPool:
    """Chunks of entries, handed out one by one."""

    entries: wp.array(dtype=wp.int32)  # (chunks * CHUNK)
    chunks: wp.int32
    reserved: wp.int32  # the first chunks: one for each chain of a region, then of a cell
    counters: wp.array(dtype=wp.int32)  # (COUNTS) of the pass, see `counters`


@wp.struct
class CandidateLists:
    """Candidate lists of regions or cells (leaves of the tree) or of blocks (features of triangles)."""

    # Of each chain its first chunk, or -1 where the pool ran out, and its number of entries.
    heads: wp.array(dtype=wp.int32)  # (lists * shares)
    lengths: wp.array(dtype=wp.int32)
    shares: wp.int32  # chains of each list


@wp.struct
class Chain:
    """A list that grows."""

    chunk: wp.int32  # its last chunk; `pool.chunks` or more if the pool ran out
    fill: wp.int32  # entries of that chunk
    length: wp.int32  # entries of all


@wp.func
def append(pool: ChunkPool, chain: Chain, keep: bool, entry: int, lane: int):
    """Add the lanes' entries to a chain, which is returned."""
    if chain.chunk >= pool.chunks:
        return chain
    mask = ballot(keep)
    added = members(mask)
    at = chain.fill + rank(mask, lane)
    fresh = chain.chunk
    if chain.fill + added > ROOM:
        fresh = pool.reserved + fetch_add_once(pool.counters, NEXT_CHUNK, 1, lane)
        if fresh < pool.chunks and lane == 0:
            pool.entries[chain.chunk * CHUNK + ROOM] = fresh
    if keep:
        if at < ROOM:
            pool.entries[chain.chunk * CHUNK + at] = entry
        elif fresh < pool.chunks:
            pool.entries[fresh * CHUNK + at - ROOM] = entry
    chain.fill = chain.fill + added
    if chain.fill > ROOM:
        chain.fill = chain.fill - ROOM
    chain.chunk = fresh
    chain.length = chain.length + added
    return chain


@wp.func_native(
    snippet="""
    int total = 0;
    // Not written out several times: code that does not fit into a GPU's cache has to be waited for.
    #pragma unroll 1
    for (int i = first; i < first + count; ++i) {
        if (heads.data[i] < 0) return -1;
        total += lengths.data[i];
    }
    return total;
"""
)
def _length(heads: wp.array(dtype=wp.int32), lengths: wp.array(dtype=wp.int32), first: int, count: int) -> int: ...


@wp.func
def list_length(lists: CandidateLists, first: int, count: int):
    """Entries of `count` chains from `first`, or -1 if the pool ran out for one."""
    return _length(lists.heads, lists.lengths, first, count)


@wp.struct
class Reader:
    """A place in a list: `left` entries of chain `chain` are not read, of those the first at `at` of `chunk`."""

    chain: wp.int32
    end: wp.int32  # one past the list's last chain
    chunk: wp.int32
    left: wp.int32
    at: wp.int32


@wp.func
def next_chain(lists: CandidateLists, reader: Reader):
    """Go on to the next chain that has entries."""
    reader.at = 0
    while reader.left == 0 and reader.chain + 1 < reader.end:
        reader.chain = reader.chain + 1
        reader.chunk = lists.heads[reader.chain]
        reader.left = lists.lengths[reader.chain]
    return reader


@wp.func
def start_reading(lists: CandidateLists, first: int, count: int):
    """The first place of the list of `count` chains from `first`; none may lack room. `left` is 0 at its end."""
    reader = Reader()
    reader.chain = first - 1
    reader.end = first + count
    return next_chain(lists, reader)


@wp.func
def start_if_complete(lists: CandidateLists, first: int, count: int):
    """`start_reading` of chains of which some may lack room: then the list's end, as there is nothing to read."""
    reader = Reader()
    if count == 1:
        # Both numbers at once: one after the other they are waited for twice.
        head = lists.heads[first]
        length = lists.lengths[first]
        reader.chain = first
        reader.end = first + 1
        reader.chunk = head
        reader.left = wp.where(head >= 0, length, 0)
    elif list_length(lists, first, count) >= 0:
        reader = start_reading(lists, first, count)
    return reader


@wp.func
def read_entry(pool: ChunkPool, reader: Reader, lane: int):
    """A lane's entry, or -1 if there is none for it."""
    if reader.at + lane < wp.min(reader.left, ROOM):
        return pool.entries[reader.chunk * CHUNK + reader.at + lane]
    return -1


@wp.func
def read_on(pool: ChunkPool, lists: CandidateLists, reader: Reader, lanes: int):
    """The place after the lanes' entries, or after so many of a chunk."""
    reader.at = reader.at + lanes
    if reader.at >= wp.min(reader.left, ROOM):
        reader.left = reader.left - wp.min(reader.left, ROOM)
        reader.at = 0
        if reader.left > 0:
            reader.chunk = pool.entries[reader.chunk * CHUNK + ROOM]
        else:
            reader = next_chain(lists, reader)
    return reader


@wp.func
def read_batch(pool: ChunkPool, lists: CandidateLists, reader: Reader, lane: int, lanes: int):
    """A lane's entry, or -1, the number of all lanes' entries, and the place after them: of several chains if short."""
    entry = int(-1)
    filled = int(0)
    while filled < lanes and reader.left > 0:
        taken = wp.min(wp.min(reader.left, ROOM) - reader.at, lanes - filled)
        if lane >= filled and lane < filled + taken:
            entry = pool.entries[reader.chunk * CHUNK + reader.at + lane - filled]
        filled = filled + taken
        reader = read_on(pool, lists, reader, taken)
    return entry, filled, reader
