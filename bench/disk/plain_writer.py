"""Plain writer, for the speed of a disk by itself: files of given sizes, one after the other or by threads."""

from __future__ import annotations

import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

# Random bytes, which no disk makes smaller, and those of one call that writes.
BLOCK = 1 << 22


def plain_seconds(folder: Path, sizes: list[int], *, threads: int = 1) -> float:
    """Seconds to write files of so many bytes into a fresh folder, each flushed before its thread goes on.

    Bytes come from one block of memory, so nothing is computed. The folder is gone afterwards.
    """
    block = memoryview(os.urandom(BLOCK))
    folder.mkdir(parents=True)
    os.sync()

    def write(job: tuple[int, int]) -> None:
        number, size = job
        with (folder / str(number)).open("wb", buffering=0) as file:
            while size > 0:
                size -= file.write(block[:size])
            os.fsync(file.fileno())

    try:
        start = time.perf_counter()
        with ThreadPoolExecutor(threads) as pool:
            for _ in pool.map(write, enumerate(sizes)):
                pass
        return time.perf_counter() - start
    finally:
        shutil.rmtree(folder)
