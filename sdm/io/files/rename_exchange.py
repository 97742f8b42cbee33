"""Exchange of two names in one step, where the system can."""

from __future__ import annotations

import ctypes
import os
from functools import cache
from pathlib import Path
from typing import Any

# Of Linux: paths are relative to where the process is, and the two change places.
AT_FDCWD, RENAME_EXCHANGE = -100, 2


def exchange(one: Path, other: Path) -> bool:
    """Let two files or folders of one file system, both there, change places: at no moment is one of them missing.

    Returns:
        Whether it was done. Systems that are not Linux, and some network file systems, cannot.
    """
    call = _renameat2()
    if call is None:
        return False
    return call(AT_FDCWD, os.fsencode(one), AT_FDCWD, os.fsencode(other), RENAME_EXCHANGE) == 0


@cache
def _renameat2() -> Any:
    # The standard library has no such function. AttributeError: a libc without it; OSError: no libc of that kind.
    try:
        call = ctypes.CDLL(None).renameat2
    except (AttributeError, OSError, TypeError):
        return None
    call.argtypes = [ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_uint]
    call.restype = ctypes.c_int
    return call
