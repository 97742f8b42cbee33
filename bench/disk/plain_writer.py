"""Plain writer, for the speed of a disk by itself: files of given sizes, one after the other or by threads."""

from __future__ import annotations

import mmap
import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

# Random bytes, which no disk makes smaller, and those of one call that writes; what disks ask sizes to be multiples of.
BLOCK, WHOLE = 1 << 22, 1 << 12


def plain_seconds(folder: Path, sizes: list[int], *, threads: int = 1, direct: bool = False) -> float:
    """Seconds to write files of so many bytes into a fresh folder, each flushed before its thread goes on.

    Bytes come from one block of memory, so nothing is computed. `direct` goes past the system's cache. The folder is
    gone afterwards.
    """
    room = mmap.mmap(-1, BLOCK)
    room.write(os.urandom(BLOCK))
    block = memoryview(room)
    folder.mkdir(parents=True)
    os.sync()
    flags = os.O_WRONLY | os.O_CREAT | (os.O_DIRECT if direct else 0)

    def write(job: tuple[int, int]) -> None:
        number, size = job
        handle = os.open(folder / str(number), flags)
        try:
            left = -(-size // WHOLE) * WHOLE if direct else size
            while left > 0:
                left -= os.write(handle, block[:left])
            os.ftruncate(handle, size)
            os.fsync(handle)
        finally:
            os.close(handle)

    try:
        start = time.perf_counter()
        with ThreadPoolExecutor(threads) as pool:
            for _ in pool.map(write, enumerate(sizes)):
                pass
        return time.perf_counter() - start
    finally:
        shutil.rmtree(folder)
