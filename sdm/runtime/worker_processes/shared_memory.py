"""Memory that this process shares with those that it starts, and arrays in it, which are handed on without a copy."""

from __future__ import annotations

import io
import mmap
import os
import pickle
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np


class SharedMemory:
    """Bytes that worker processes see too. They have no name on the system, so nothing is left of them after a kill.

    Args:
        size: Bytes.

    Attributes:
        handle: Of the system, for processes that inherit it.
        content: (size,) bytes.
        address: Where they begin in this process.

    Raises:
        OSError: The system has no such memory.
    """

    def __init__(self, size: int) -> None:
        self.handle = os.memfd_create("sdm")
        try:
            os.ftruncate(self.handle, size)
            self.content = np.frombuffer(mmap.mmap(self.handle, size), np.uint8)
        except OSError:
            os.close(self.handle)
            raise
        # Asking an array takes as long as sending it.
        self.address = int(self.content.ctypes.data)

    def close(self) -> None:
        """Let go of it. Processes that have it keep it until their end."""
        os.close(self.handle)


def can_share() -> bool:
    """True on systems that have such memory."""
    return hasattr(os, "memfd_create")


def packed(given: Any, several: Sequence[SharedMemory]) -> bytes:
    """Pickle for a process that has inherited some memory: contiguous arrays there are not copied."""
    if not several:
        return pickle.dumps(given, pickle.HIGHEST_PROTOCOL)
    found = io.BytesIO()
    _Pickler(found, several).dump(given)
    return found.getvalue()


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, several: Sequence[SharedMemory]) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._several = several

    def reducer_override(self, given: Any) -> Any:
        if type(given) is np.ndarray and given.nbytes and given.flags.c_contiguous:
            address = given.ctypes.data
            for one in self._several:
                if one.address <= address < one.address + one.content.nbytes:
                    return array_at, (one.handle, address - one.address, given.shape, given.dtype.str)
        return NotImplemented


def array_at(handle: int, begin: int, shape: tuple[int, ...], dtype: str) -> np.ndarray:
    """Array in memory that this process has inherited, to be read."""
    return np.ndarray(shape, dtype, _attached(handle), begin)


@cache
def _attached(handle: int) -> mmap.mmap:
    size = os.fstat(handle).st_size
    # All pages at once, which are there already: otherwise one sixteenth of them costs a fault each.
    return mmap.mmap(handle, size, flags=mmap.MAP_SHARED | mmap.MAP_POPULATE, prot=mmap.PROT_READ)
