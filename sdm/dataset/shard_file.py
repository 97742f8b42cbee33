"""Bytes of a shard's files, as Zarr itself would write them, made by many threads and without a store in between.

A shard of maps is its chunks one after the other, each compressed and with a CRC32C of its own, and at the end where
each begins and how long it is, with a CRC32C too (Zarr's sharding codec).
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from typing import Any, NamedTuple

import google_crc32c
import numpy as np

from sdm.dataset.compressor import MOST_MORE, Compressor
from sdm.dataset.versions import LARGE_BLOCKS, WITH_CHECKSUMS

# In the index, of a chunk that is not there.
ABSENT = (1 << 64) - 1
# Bytes that Blosc shuffles and compresses at a time; its own choice, 0, is 32 KiB, where half of the planes of bytes,
# which are noise, cannot be told from the others.
BLOCK = 1 << 20
# Bytes of maps that are compressed, hashed and written at a time, since Python's lock is handed on for each, and of
# those that are being compressed.
TASK, AHEAD = 1 << 22, 1 << 25
CHECKSUM = 4


class _Packed(NamedTuple):
    """Chunks one after the other: the memory they are in, bytes of all, and of each with its checksum."""

    room: np.ndarray
    used: int
    sizes: list[int]


def rows_content(values: np.ndarray, manifest: dict[str, Any], dtype: str) -> bytes:
    """Content of the file of rows of numbers (n,...), one a sample: a whole chunk, as Zarr keeps the last one."""
    room = np.zeros((manifest["shard"], *values.shape[1:]), dtype=np.dtype(dtype).newbyteorder("<"))
    room[: len(values)] = values
    content = room.tobytes()
    return content + _checksum(content) if manifest["version"] >= WITH_CHECKSUMS else content


def blocksize_of(manifest: dict[str, Any]) -> int:
    """Blosc's block size for the maps of a dataset."""
    return BLOCK if manifest["version"] >= LARGE_BLOCKS else 0


def maps_content(maps: np.ndarray, manifest: dict[str, Any], pool: Executor) -> Iterator[list[Any]]:
    """Content of the file of maps (n,nx,ny,nz), some pieces of bytes at a time.

    The pieces are what they are until the next ones are asked for, and maps must not change before all is taken.
    """
    index = np.full((manifest["shard"], 2), ABSENT, dtype="<u8")
    number = at = 0
    zstd = manifest["compression"] == "zstd"
    for pieces, sizes in _compressed(maps, pool, blocksize_of(manifest)) if zstd else _plain(maps):
        for size in sizes:
            index[number] = at, size
            number, at = number + 1, at + size
        yield pieces
    end = index.tobytes()
    yield [end, _checksum(end)]


def _groups(maps: np.ndarray) -> Iterator[np.ndarray]:
    """Maps that are handled at a time, little-endian and one after the other in memory."""
    each = max(1, TASK // max(1, maps[0].nbytes))
    for begin in range(0, len(maps), each):
        yield np.ascontiguousarray(maps[begin : begin + each], maps.dtype.newbyteorder("<"))


def _plain(maps: np.ndarray) -> Iterator[tuple[list[Any], list[int]]]:
    # In the caller's thread: handing a map to another one takes longer than its checksum.
    for group in _groups(maps):
        rows = group.reshape(len(group), -1).view(np.uint8)
        pieces = [piece for row in rows for piece in (row, _checksum(row))]
        yield pieces, [rows.shape[1] + CHECKSUM] * len(rows)


def _compressed(maps: np.ndarray, pool: Executor, blocksize: int) -> Iterator[tuple[list[Any], list[int]]]:
    compressor, groups = Compressor(maps.dtype.itemsize, blocksize), _groups(maps)
    waiting: deque[Future[_Packed]] = deque()
    # Memory that is used again, as the system hands out fresh one page by page.
    spare: list[np.ndarray] = []
    try:
        while True:
            while len(waiting) < max(1, AHEAD // TASK) and (group := next(groups, None)) is not None:
                size = group.nbytes + len(group) * (MOST_MORE + CHECKSUM)
                room = spare.pop() if spare else np.empty(size, np.uint8)
                waiting.append(pool.submit(_packed, group, compressor, room))
            if not waiting:
                return
            done = waiting.popleft().result()
            yield [done.room[: done.used]], done.sizes
            spare.append(done.room)
    finally:
        for future in waiting:
            future.cancel()


def _packed(maps: np.ndarray, compressor: Compressor, room: np.ndarray) -> _Packed:
    used, sizes = 0, []
    for values in maps:
        size = compressor.into(values, room[used:])
        end = used + size + CHECKSUM
        room[used + size : end] = np.frombuffer(_checksum(room[used : used + size]), np.uint8)
        sizes.append(size + CHECKSUM)
        used = end
    return _Packed(room, used, sizes)


def _checksum(content: Any) -> bytes:
    """CRC32C of bytes, or of an array of them."""
    return struct.pack("<I", google_crc32c.value(content))
