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

from sdm.dataset.manifest import WITH_CHECKSUMS

# In the index, of a chunk that is not there.
ABSENT = (1 << 64) - 1
# Chunks that are being compressed at a time.
AHEAD = 64


def rows_content(values: np.ndarray, manifest: dict[str, Any], dtype: str) -> bytes:
    """Content of the file of rows of numbers (n,...), one a sample: a whole chunk, as Zarr keeps the last one."""
    room = np.zeros((manifest["shard"], *values.shape[1:]), dtype=np.dtype(dtype).newbyteorder("<"))
    room[: len(values)] = values
    content = room.tobytes()
    return content + _checksum(content) if manifest["version"] >= WITH_CHECKSUMS else content


def maps_content(maps: np.ndarray, manifest: dict[str, Any], pool: Executor) -> Iterator[bytes]:
    """Content of the file of maps (n,nx,ny,nz), piece by piece; they must not change before all is taken."""
    chunks = _compressed(maps, pool) if manifest["compression"] == "zstd" else _plain(maps)
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


def _compressed(maps: np.ndarray, pool: Executor) -> Iterator[tuple[bytes, bytes]]:
    codec = Blosc(cname="zstd", clevel=1, shuffle=SHUFFLE, blocksize=0)
    waiting: deque[Future[tuple[bytes, bytes]]] = deque()
    try:
        for number in range(len(maps)):
            while number + len(waiting) < len(maps) and len(waiting) < AHEAD:
                waiting.append(pool.submit(_chunk, maps[number + len(waiting)], codec))
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


def _chunk(values: np.ndarray, codec: Blosc | None) -> tuple[bytes, bytes]:
    plain = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    # A checksum takes nothing but bytes.
    content = plain.tobytes() if codec is None else bytes(codec.encode(plain))
    return content, _checksum(content)


def _checksum(content: bytes) -> bytes:
    return struct.pack("<I", google_crc32c.value(content))
