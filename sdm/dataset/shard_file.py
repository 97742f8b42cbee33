"""Bytes of a shard's files, as Zarr itself would write them, made by many threads and without a store in between.

A shard of maps is its chunks one after the other, each compressed and with a CRC32C of its own, and at the end where
each begins and how long it is, with a CRC32C too (Zarr's sharding codec).
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from typing import Any

import google_crc32c
import numpy as np
from numcodecs.blosc import SHUFFLE, Blosc

from sdm.dataset.manifest import LARGE_BLOCKS, WITH_CHECKSUMS

# In the index, of a chunk that is not there.
ABSENT = (1 << 64) - 1
# Bytes that Blosc shuffles and compresses at a time; its own choice, 0, is 32 KiB, where half of the planes of bytes,
# which are noise, cannot be told from the others.
BLOCK = 1 << 20
# Bytes of maps that a thread compresses at a time, as it is handed each task by Python's lock, and of those that are on
# the way.
TASK, AHEAD = 1 << 22, 1 << 26


def rows_content(values: np.ndarray, manifest: dict[str, Any], dtype: str) -> bytes:
    """Content of the file of rows of numbers (n,...), one a sample: a whole chunk, as Zarr keeps the last one."""
    room = np.zeros((manifest["shard"], *values.shape[1:]), dtype=np.dtype(dtype).newbyteorder("<"))
    room[: len(values)] = values
    content = room.tobytes()
    return content + _checksum(content) if manifest["version"] >= WITH_CHECKSUMS else content


def blocksize_of(manifest: dict[str, Any]) -> int:
    """Blosc's block size for the maps of a dataset."""
    return BLOCK if manifest["version"] >= LARGE_BLOCKS else 0


def maps_content(maps: np.ndarray, manifest: dict[str, Any], pool: Executor) -> Iterator[bytes]:
    """Content of the file of maps (n,nx,ny,nz), piece by piece; they must not change before all is taken."""
    chunks = _compressed(maps, pool, blocksize_of(manifest)) if manifest["compression"] == "zstd" else _plain(maps)
    index = np.full((manifest["shard"], 2), ABSENT, dtype="<u8")
    at = 0
    for number, (content, checksum) in enumerate(chunks):
        size = len(content) + len(checksum)
        index[number] = at, size
        at += size
        yield content
        yield checksum
        # Not kept until the next one is there.
        del content
    end = index.tobytes()
    yield end
    yield _checksum(end)


def _plain(maps: np.ndarray) -> Iterator[tuple[bytes, bytes]]:
    # In the caller's thread: handing a map to another one takes longer than its checksum.
    for values in maps:
        yield _chunk(values, None)


def _compressed(maps: np.ndarray, pool: Executor, blocksize: int) -> Iterator[tuple[bytes, bytes]]:
    codec = Blosc(cname="zstd", clevel=1, shuffle=SHUFFLE, blocksize=blocksize)
    each = max(1, TASK // max(1, maps[0].nbytes))
    tasks = iter(range(0, len(maps), each))
    waiting: deque[Future[list[tuple[bytes, bytes]]]] = deque()
    try:
        while True:
            while len(waiting) < max(1, AHEAD // TASK) and (begin := next(tasks, None)) is not None:
                waiting.append(pool.submit(_chunks, maps[begin : begin + each], codec))
            if not waiting:
                return
            yield from waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


def _chunks(maps: np.ndarray, codec: Blosc) -> list[tuple[bytes, bytes]]:
    return [_chunk(values, codec) for values in maps]


def _chunk(values: np.ndarray, codec: Blosc | None) -> tuple[bytes, bytes]:
    plain = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    # A checksum takes nothing but bytes.
    content = plain.tobytes() if codec is None else bytes(codec.encode(plain))
    return content, _checksum(content)


def _checksum(content: bytes) -> bytes:
    return struct.pack("<I", google_crc32c.value(content))
