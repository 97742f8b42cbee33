"""Compression of a map into memory of the caller, by Blosc's zstd: the bytes of `numcodecs.blosc.Blosc`.

numcodecs copies what it has compressed into a new object, and holds Python's lock for that, for which sixteen threads
then wait: its own copy of the library is called directly, where that can be done.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numcodecs.blosc
import numpy as np
from numcodecs.blosc import SHUFFLE, Blosc

LEVEL, NAME = 1, "zstd"
# Bytes that a compressed chunk may have more than the plain one.
MOST_MORE = 16


class Compressor:
    """Blosc's zstd of level 1, with bytes shuffled. Safe to use from several threads.

    Args:
        itemsize: Bytes of a number.
        blocksize: Bytes that are shuffled and compressed at a time; 0 is Blosc's own choice.
    """

    def __init__(self, itemsize: int, blocksize: int) -> None:
        self._itemsize, self._blocksize = itemsize, blocksize
        self._codec = Blosc(cname=NAME, clevel=LEVEL, shuffle=SHUFFLE, blocksize=blocksize)
        self._direct = direct_call()

    def into(self, values: np.ndarray, room: np.ndarray) -> int:
        """Compress contiguous values into bytes (n,), `MOST_MORE` more than they have or longer; how many it takes."""
        if self._direct is not None:
            return self._direct(self._itemsize, self._blocksize, values, room)
        content = self._codec.encode(values)
        room[: len(content)] = np.frombuffer(content, np.uint8)
        return len(content)


@cache
def direct_call() -> Callable[[int, int, np.ndarray, np.ndarray], int] | None:
    """Function that compresses by the library in numcodecs; None where its names are hidden, or it is another one."""
    try:
        function: Any = ctypes.CDLL(numcodecs.blosc.__file__).blosc_compress_ctx
    except (OSError, AttributeError):
        return None
    size, pointer = ctypes.c_size_t, ctypes.c_void_p
    function.argtypes = [
        ctypes.c_int,
        ctypes.c_int,
        size,
        size,
        pointer,
        pointer,
        size,
        ctypes.c_char_p,
        size,
        ctypes.c_int,
    ]
    function.restype = ctypes.c_int

    def call(itemsize: int, blocksize: int, values: np.ndarray, room: np.ndarray) -> int:
        places = values.ctypes.data, room.ctypes.data
        # Each thread compresses its own map.
        used = function(LEVEL, SHUFFLE, itemsize, values.nbytes, *places, room.nbytes, NAME.encode(), blocksize, 1)
        if used <= 0:
            raise RuntimeError(f"Blosc cannot compress {values.nbytes:,} bytes (it says {used})")
        return used

    # That it is the function that it is taken for is seen by its bytes.
    values = (np.arange(4096, dtype=np.float32) % 97) ** 2
    room = np.zeros(values.nbytes + MOST_MORE, np.uint8)
    used = call(4, 0, values, room)
    expected = Blosc(cname=NAME, clevel=LEVEL, shuffle=SHUFFLE, blocksize=0).encode(values)
    return call if room[:used].tobytes() == bytes(expected) else None
