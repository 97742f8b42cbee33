"""Files that go to their disk past the system's cache: threads that write large ones do not wait for each other.

A file that goes by the cache is copied there first, and then its flush waits: for the journal, and so for what other
files have in the cache. Past it the disk is busy from the first bytes on, and a flush has little left to do. While the
disk has one part of a large file, the next one is gathered.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from sdm.io.files.atomic import write_all
from sdm.io.files.thread_room import thread_room

# Bytes of one call that writes, and what disks ask their sizes to be multiples of.
ROOM, BLOCK = 1 << 23, 1 << 12
# Smaller files are not worth it.
LEAST = 1 << 21
# Smaller ones are not worth a thread that writes them; more threads than have files to write wait for nothing.
LEAST_BESIDE, MOST_BESIDE = 1 << 25, 32


class DirectFile:
    """A new file for bytes that come piece by piece; a context manager.

    Args:
        path: The file. An older one is replaced.
        size: About how large it will be. A large one is written by a thread of its own, beside whoever has more.

    On file systems in memory or over a network, on other systems than Linux, and where `size` is small, it is a file as
    any other. Whoever wants it on the disk flushes it, as any other.

    Raises:
        OSError: It cannot be written; from all methods.
    """

    def __init__(self, path: Path, size: int) -> None:
        handle = _opened_directly(path) if size >= LEAST else None
        self._direct = handle is not None
        self._file: Any = path.open("wb", buffering=0) if handle is None else os.fdopen(handle, "wb", buffering=0)
        self._beside = size >= LEAST_BESIDE
        self._at = self._written = self._turn = 0
        self._pending: Future[None] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._end()
        finally:
            try:
                # Memory and file are in use until then.
                self._wait()
            finally:
                self._file.close()

    def write(self, piece: Any) -> None:
        """Write bytes."""
        self.write_all([piece])

    def write_all(self, pieces: Sequence[Any]) -> None:
        """Write pieces of bytes, one after the other."""
        if not self._direct:
            write_all(self._file, pieces)
            return
        for piece in pieces:
            left = np.frombuffer(piece, np.uint8) if len(piece) else np.empty(0, np.uint8)
            while len(left):
                count = min(len(left), ROOM - self._at)
                _buffer(self._turn)[self._at : self._at + count] = left[:count]
                self._at, left = self._at + count, left[count:]
                if self._at == ROOM:
                    self._whole_room()

    def _whole_room(self) -> None:
        self._wait()
        room, self._at = _buffer(self._turn), 0
        if not self._beside:
            self._put(room)
            return
        self._pending = _threads().submit(self._put, room)
        self._turn = 1 - self._turn

    def _wait(self) -> None:
        pending, self._pending = self._pending, None
        if pending is not None:
            pending.result()

    def _end(self) -> None:
        self._wait()
        if not self._at:
            return
        whole, size = -(-self._at // BLOCK) * BLOCK, self._written + self._at
        room = _buffer(self._turn)
        room[self._at : whole] = 0
        self._put(room[:whole])
        self._file.truncate(size)

    def _put(self, content: np.ndarray) -> None:
        try:
            write_all(self._file, [content.data])
        except OSError as error:
            if error.errno != errno.EINVAL:
                raise
            # A disk of larger blocks.
            import fcntl

            fcntl.fcntl(self._file, fcntl.F_SETFL, fcntl.fcntl(self._file, fcntl.F_GETFL) & ~os.O_DIRECT)
            self._file.seek(self._written)
            write_all(self._file, [content.data])
        self._written += len(content)


def _opened_directly(path: Path) -> int | None:
    """A new file past the cache; None where the file system has no disk of its own, or cannot."""
    direct = getattr(os, "O_DIRECT", None)
    if direct is None or os.major(path.parent.stat().st_dev) == 0:
        return None
    try:
        return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | direct, 0o666)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
        return None


def _buffer(turn: int) -> np.ndarray:
    """One of two pieces of memory of this thread, at the beginning of a page, as disks ask for."""
    return thread_room(f"disk {turn}", ROOM)


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(MOST_BESIDE, thread_name_prefix="sdm-disk")
