"""Memory of a thread that is used again: the system hands out fresh memory page by page, as slowly as it is copied."""

from __future__ import annotations

import mmap
import threading
from contextlib import suppress

import numpy as np

# More is not kept.
MOST_KEPT = 1 << 25

_own = threading.local()


def thread_room(name: str, size: int) -> np.ndarray:
    """Bytes (size,) of this thread, at the beginning of a page; the next call with the name gives the same ones."""
    if size > MOST_KEPT:
        return np.empty(size, np.uint8)
    if not hasattr(_own, "rooms"):
        _own.rooms = {}
    kept = _own.rooms.get(name)
    if kept is None or len(kept) < size:
        kept = _own.rooms[name] = fresh_pages(size)
    return kept[:size]


def fresh_pages(size: int) -> np.ndarray:
    """Fresh bytes (size,) at the beginning of a page, in large pages where the system has some."""
    memory = mmap.mmap(-1, size)
    if hasattr(mmap, "MADV_HUGEPAGE"):
        # A system without large pages says so.
        with suppress(OSError):
            memory.madvise(mmap.MADV_HUGEPAGE)
    return np.frombuffer(memory, np.uint8)
