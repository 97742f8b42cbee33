"""Imports during which Python seldom looks for garbage."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

# Objects made between two looks. Torch, Warp and kernels make half a million that stay, and looks as often as usual
# take a quarter of their import. With none at all, or five times as few, looks after it take longer by as much.
BETWEEN = 20_000


@contextmanager
def rare_collections() -> Iterator[None]:
    """Let Python look for garbage less often in the block; who has turned that off, or set it rarer, keeps it."""
    before = gc.get_threshold()
    during = (max(before[0], BETWEEN) if before[0] else 0, *before[1:])
    gc.set_threshold(*during)
    try:
        yield
    finally:
        # Others may have set their own meanwhile.
        if gc.get_threshold() == during:
            gc.set_threshold(*before)
