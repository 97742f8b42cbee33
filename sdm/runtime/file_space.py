"""Space of a file on its disk or in memory: taken beforehand, and given back while the file is still in use."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

# Of `fallocate`: a hole, in a file that stays as long as it is.
HOLE = 1 | 2


def take_space(handle: int, size: int) -> bool:
    """Make an empty file so many bytes long, with space for them; False where the system cannot, or has none."""
    call = _fallocate()
    return call is not None and call(handle, 0, 0, size) == 0


def give_space_back(handle: int, size: int) -> bool:
    """Give back what a file's first bytes take: they are zeros then. False where the system cannot."""
    call = _fallocate()
    return call is not None and call(handle, HOLE, 0, size) == 0


@cache
def _fallocate() -> Callable[[int, int, int, int], int] | None:
    # `os.posix_fallocate` knows no holes, and writes to every block where a file system takes no space.
    try:
        function: Any = ctypes.CDLL(None).fallocate64
    except (OSError, AttributeError, TypeError):
        return None
    function.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_int64, ctypes.c_int64]
    function.restype = ctypes.c_int
    return function
