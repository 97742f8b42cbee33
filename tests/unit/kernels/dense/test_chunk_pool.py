"""Lists as chains of chunks: what is appended is read again, over chunks and chains, also when the pool runs out."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
import warp as wp

import sdm.engine.acceleration  # noqa: F401 (starts Warp quietly)
from sdm.kernels.dense.chunk_pool import (
    CHUNK,
    ROOM,
    CandidateLists,
    Chain,
    ChunkPool,
    append,
    list_length,
    read_entry,
    read_on,
    start_reading,
)
from sdm.kernels.dense.counters import COUNTS, NEXT_CHUNK
from sdm.kernels.primitives.atomics import fetch_add_once

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _fill(
    pool: ChunkPool,
    lists: CandidateLists,
    chains: int,
    entries: wp.array(dtype=int),
    keep: wp.array(dtype=int),
    ends: wp.array(dtype=int),
):
    """Chain after chain, entries ends[i] to ends[i + 1] of those to keep; as `cells` and `regions` do it."""
    for i in range(chains):
        chain = Chain()
        chain.chunk = fetch_add_once(pool.counters, NEXT_CHUNK, 1, 0)
        head = chain.chunk
        for at in range(ends[i], ends[i + 1]):
            chain = append(pool, chain, keep[at] != 0, entries[at], 0)
        lists.heads[i] = wp.where(chain.chunk < pool.chunks, head, -1)
        lists.lengths[i] = chain.length


@wp.kernel
def _fill_by_turns(pool: ChunkPool, lists: CandidateLists, chains: int, length: int):
    """All chains grow at the same time: their chunks lie mixed in the pool."""
    for i in range(chains):
        lists.heads[i] = fetch_add_once(pool.counters, NEXT_CHUNK, 1, 0)
        lists.lengths[i] = lists.heads[i]
    for n in range(length):
        for i in range(chains):
            chain = Chain()
            chain.chunk = lists.lengths[i]
            chain.fill = n - (wp.max(n - 1, 0) / ROOM) * ROOM
            chain = append(pool, chain, True, 1000 * i + n, 0)
            lists.lengths[i] = chain.chunk
    for i in range(chains):
        lists.lengths[i] = length


@wp.kernel
def _read(
    pool: ChunkPool,
    lists: CandidateLists,
    first: int,
    chains: int,
    out: wp.array(dtype=int),
    count: wp.array(dtype=int),
):
    count[0] = list_length(lists, first, chains)
    count[1] = 0
    if count[0] > 0:
        reader = start_reading(lists, first, chains)
        while reader.left > 0 and count[1] < out.shape[0]:
            out[count[1]] = read_entry(pool, reader, 0)
            count[1] = count[1] + 1
            reader = read_on(pool, lists, reader, 1)
        # At the end there is nothing to read, and it stays so.
        if read_entry(pool, reader, 0) >= 0:
            count[1] = -1


class Made(NamedTuple):
    """Chains, and the pool that they are in."""

    pool: Any
    lists: Any


def empty_lists(chains: int, chunks: int) -> Made:
    pool, lists = ChunkPool(), CandidateLists()
    lists.heads = wp.full(chains, -7, dtype=int, device="cpu")
    lists.lengths = wp.full(chains, -7, dtype=int, device="cpu")
    pool.chunks = chunks
    # A guard behind the pool.
    pool.entries = wp.full((chunks + 1) * CHUNK, -9, dtype=int, device="cpu")
    pool.counters = wp.zeros(COUNTS, dtype=int, device="cpu")
    return Made(pool, lists)


def filled(sizes: list[int], chunks: int, skipped: int = 0) -> tuple[Made, list[np.ndarray]]:
    """Chains of these sizes, `skipped` entries left out for each that is kept, and what they should hold."""
    made = empty_lists(len(sizes), chunks)
    rng = np.random.default_rng(1)
    entries = rng.integers(0, 1 << 30, (1 + skipped) * sum(sizes) + len(sizes)).astype(np.int32)
    keep = np.zeros(len(entries), np.int32)
    expected, ends, at = [], [0], 0
    for size in sizes:
        some = at + np.sort(rng.permutation(size * (1 + skipped))[:size])
        keep[some] = 1
        expected.append(entries[some])
        at += size * (1 + skipped)
        ends.append(at)
    arrays = [wp.array(np.asarray(v, np.int32), dtype=int, device="cpu") for v in (entries, keep, ends)]
    wp.launch(_fill, 1, [*made, len(sizes), *arrays], device="cpu")
    return made, expected


def read(made: Made, first: int, chains: int, most: int = 1 << 14) -> tuple[int, np.ndarray]:
    out, count = wp.full(most, -5, dtype=int, device="cpu"), wp.zeros(2, dtype=int, device="cpu")
    wp.launch(_read, 1, [*made, first, chains, out, count], device="cpu")
    length, found = count.numpy().tolist()
    assert found >= 0
    return length, out.numpy()[:found]


@pytest.mark.parametrize("skipped", [0, 3])
@pytest.mark.parametrize(
    "sizes",
    [
        [0],
        [1],
        [ROOM - 1],
        [ROOM],
        [ROOM + 1],
        [2 * ROOM],
        [5 * ROOM + 1],
        [0, 0, 0],
        [0, 3, 0],
        [0, 0, ROOM, 0, 2 * ROOM, 0],
        [ROOM, ROOM, ROOM + 1, ROOM - 1],
        [1, 0, 1000, 0, 0, 7],
    ],
)
def test_what_is_appended_is_read(sizes, skipped):
    made, expected = filled(sizes, 64, skipped)
    assert made.lists.lengths.numpy().tolist() == sizes
    length, found = read(made, 0, len(sizes))
    assert length == sum(sizes)
    np.testing.assert_array_equal(found, np.concatenate(expected))
    # Any run of chains is a list too.
    for first in range(len(sizes)):
        for chains in range(1, len(sizes) - first + 1):
            length, found = read(made, first, chains)
            some = np.concatenate(expected[first : first + chains])
            assert length == len(some)
            np.testing.assert_array_equal(found, some)


def test_no_chunk_is_taken_that_is_not_needed():
    for size, chunks in ((0, 1), (1, 1), (ROOM, 1), (ROOM + 1, 2), (3 * ROOM, 3), (3 * ROOM + 1, 4)):
        made, _ = filled([size], 8)
        assert made.pool.counters.numpy()[NEXT_CHUNK] == chunks


@pytest.mark.parametrize("length", [1, ROOM, ROOM + 1, 4 * ROOM, 300])
def test_chains_that_grow_together(length):
    made = empty_lists(3, 64)
    wp.launch(_fill_by_turns, 1, [*made, 3, length], device="cpu")
    total, found = read(made, 0, 3)
    assert total == 3 * length
    np.testing.assert_array_equal(found, (1000 * np.arange(3)[:, None] + np.arange(length)).ravel())


@pytest.mark.parametrize("sizes", [[3 * ROOM + 1], [ROOM, 5 * ROOM, 3], [10 * ROOM, ROOM, 0, 3]])
def test_a_pool_that_runs_out_is_noticed(sizes):
    made, expected = filled(sizes, 3)
    heads = made.lists.heads.numpy()
    assert (heads == -1).any()
    assert read(made, 0, len(sizes))[0] == -1
    # Nothing was written behind it, and the chains that had room are whole.
    assert (made.pool.entries.numpy()[3 * CHUNK :] == -9).all()
    for i, entries in enumerate(expected):
        if heads[i] >= 0:
            np.testing.assert_array_equal(read(made, i, 1)[1], entries)


def test_a_pool_that_is_just_large_enough():
    made, expected = filled([3 * ROOM, ROOM], 4)
    assert read(made, 0, 2)[0] == 4 * ROOM
    np.testing.assert_array_equal(read(made, 0, 2)[1], np.concatenate(expected))
