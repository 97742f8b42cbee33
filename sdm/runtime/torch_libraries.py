"""Torch's native libraries loaded by a thread, while this one imports what needs no torch.

To load them takes a third of torch's import, without Python's lock if it is done by `ctypes`.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

# In the order in which torch loads them itself, and with the same scope.
GLOBAL, CPU = "libtorch_global_deps.so", "libtorch_cpu.so"


def begin() -> threading.Thread | None:
    """Load them from now on; the thread that does it, or None where that is not known to help."""
    if sys.platform != "linux" or "torch" in sys.modules:
        return None
    found = find_spec("torch")
    if found is None or found.origin is None:
        return None
    thread = threading.Thread(target=_load, args=(Path(found.origin).parent / "lib",), name="sdm torch libraries")
    thread.start()
    return thread


def _load(folder: Path) -> None:
    # Whatever is wrong with them is said by the import of torch.
    with suppress(OSError):
        ctypes.CDLL(str(folder / GLOBAL), mode=ctypes.RTLD_GLOBAL)
        # Where other places are named, torch first sees to it that libraries of its own version are taken.
        if not os.environ.get("LD_LIBRARY_PATH"):
            ctypes.CDLL(str(folder / CPU))
