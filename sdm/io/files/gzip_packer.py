"""Gzip by ISA-L into memory that is used again.

`isal_zlib.compressobj` begins with 16 KiB of fresh memory and asks for twice as much, with Python's lock, whenever that
is full: eleven times for a map of 8 MiB, for which threads that write maps wait. ISA-L's own function in the same
library is called instead, where that can be done. What is unpacked is the same; blocks of what is packed end elsewhere.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
from isal import isal_zlib

from sdm.io.files.thread_room import thread_room

# Of 0 to 3. Distances hardly shrink by more work. zlib's number for gzip, without a name or time.
LEVEL, AS_GZIP = 1, 31
# Of ISA-L: the kind of stream, the reach of its matches, and bytes of memory of that level, which bytes depend on.
GZIP, HISTORY, LEVEL_MEMORY = 1, 15, 4096 + 2 * 8192 + 4 * 64 * 1024
# Bytes of packed content at a time, some more than what a map of 128^3 has.
ROOM = (1 << 23) + (1 << 18)
# Bytes of ISA-L's stream, which has 90,000.
STREAM = 1 << 18


class _Stream(ctypes.Structure):
    """The beginning of `struct isal_zstream`, the part of who calls."""

    _fields_ = (
        ("next_in", ctypes.c_void_p),
        ("avail_in", ctypes.c_uint32),
        ("total_in", ctypes.c_uint32),
        ("next_out", ctypes.c_void_p),
        ("avail_out", ctypes.c_uint32),
        ("total_out", ctypes.c_uint32),
        ("hufftables", ctypes.c_void_p),
        ("level", ctypes.c_uint32),
        ("level_buf_size", ctypes.c_uint32),
        ("level_buf", ctypes.c_void_p),
        ("end_of_stream", ctypes.c_uint16),
        ("flush", ctypes.c_uint16),
        ("gzip_flag", ctypes.c_uint16),
        ("hist_bits", ctypes.c_uint16),
    )


def packed(pieces: Iterator[np.ndarray]) -> Iterator[Any]:
    """Gzip of pieces of bytes (n,), some of it at a time, which is what it is until the next is asked for."""
    direct = direct_call()
    yield from _plain(pieces) if direct is None else direct(pieces)


def _plain(pieces: Iterator[np.ndarray]) -> Iterator[bytes]:
    packer = isal_zlib.compressobj(LEVEL, wbits=AS_GZIP)
    for piece in pieces:
        yield packer.compress(piece.data)
    yield packer.flush()


@cache
def direct_call() -> Callable[[Iterator[np.ndarray]], Iterator[Any]] | None:
    """Function that packs by the library in `isal`; None where its names are hidden, or it is another one."""
    try:
        library: Any = ctypes.CDLL(isal_zlib.__file__)
        begin, go_on = library.isal_deflate_init, library.isal_deflate
    except (OSError, AttributeError):
        return None
    begin.argtypes = go_on.argtypes = [ctypes.c_void_p]
    begin.restype, go_on.restype = None, ctypes.c_int

    def call(pieces: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
        memory, level = thread_room("isal stream", STREAM), thread_room("isal level", LEVEL_MEMORY)
        room = thread_room("packed", ROOM)
        memory[:] = 0
        stream = _Stream.from_address(memory.ctypes.data)
        begin(memory.ctypes.data)
        stream.level, stream.level_buf, stream.level_buf_size = LEVEL, level.ctypes.data, len(level)
        stream.gzip_flag, stream.hist_bits = GZIP, HISTORY

        def taken(piece: np.ndarray, last: bool) -> Iterator[np.ndarray]:
            stream.next_in, stream.avail_in, stream.end_of_stream = piece.ctypes.data, len(piece), last
            while True:
                stream.next_out, stream.avail_out = room.ctypes.data, len(room)
                if code := go_on(memory.ctypes.data):
                    raise RuntimeError(f"ISA-L cannot compress {len(piece):,} bytes (it says {code})")
                if used := len(room) - stream.avail_out:
                    yield room[:used]
                if stream.avail_out:
                    return

        for piece in pieces:
            yield from taken(piece, last=False)
        yield from taken(np.empty(0, np.uint8), last=True)

    # That it is the function that it is taken for is seen by its bytes, which are the same while they are few.
    values = ((np.arange(1 << 16, dtype=np.float32) % 97) ** 2).view(np.uint8)
    given = [values[:1000], values[1000:]]
    expected = b"".join(_plain(iter(given)))
    return call if b"".join(part.tobytes() for part in call(iter(given))) == expected else None
