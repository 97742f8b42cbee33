"""Memory that this process shares with those that it starts."""

from __future__ import annotations

import mmap
import os
from functools import cache

import numpy as np


class SharedMemory:
    """Bytes that worker processes see too. They have no name on the system, so nothing is left of them after a kill.

    Args:
        size: Bytes.

    Attributes:
        handle: What a process that inherits it gives to `attached`.
        content: (size,) bytes.

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

    def close(self) -> None:
        """Let go of it. Processes that have it keep it until their end."""
        os.close(self.handle)


def can_share() -> bool:
    """True on systems that have such memory."""
    return hasattr(os, "memfd_create")


@cache
def attached(handle: int) -> np.ndarray:
    """Bytes of a `SharedMemory` that this process has inherited, to be read."""
    size = os.fstat(handle).st_size
    # All pages at once, which are there already: otherwise one sixteenth of them costs a fault each.
    flags = mmap.MAP_SHARED | mmap.MAP_POPULATE
    return np.frombuffer(mmap.mmap(handle, size, flags=flags, prot=mmap.PROT_READ), np.uint8)
