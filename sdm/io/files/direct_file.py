"""Files that go to their disk past the system's cache: threads that write large ones do not wait for each other.

A file that goes by the cache is copied there first, and then its flush waits: for the journal, and so for what other
files have in the cache. Past it the disk is busy from the first bytes on, and a flush has little left to do. While the
disk has some parts of a large file, the next one is gathered. Its place is taken beforehand, as a file that grows takes
one part at a time.
"""

from __future__ import annotations

import errno
import os
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from sdm.io.files.atomic import write_all
from sdm.io.files.thread_room import fresh_pages
from sdm.runtime.file_space import take_space

# Bytes of one call that writes, and what disks ask their sizes to be multiples of.
ROOM, BLOCK = 1 << 22, 1 << 12
# Smaller files are not worth it.
LEAST = 1 << 21
# Smaller ones are not worth threads that write them. Parts of a file that the disk has at a time.
LEAST_BESIDE, PARTS = 1 << 25, 4
# More threads than have files to write wait for nothing.
MOST_BESIDE = 32


class DirectFile:
    """A new file for bytes that come piece by piece; a context manager.

    Args:
        path: The file. An older one is replaced.
        size: About how large it will be. A large one is written by threads of its own, beside whoever has more.

    On file systems in memory or over a network, on other systems than Linux, and where `size` is small, it is a file as
    any other. Whoever wants it on the disk flushes it, as any other.

    Raises:
        OSError: It cannot be written; from all methods.
    """

    def __init__(self, path: Path, size: int) -> None:
        handle = _opened_directly(path) if size >= LEAST else None
        self._direct = handle is not None
        self._file: Any = path.open("wb", buffering=0) if handle is None else os.fdopen(handle, "wb", buffering=0)
        self._parts = PARTS if size >= LEAST_BESIDE else 0
        # The next part, bytes in it, and before it.
        self._room: np.ndarray | None = None
        self._at = self._begin = 0
        self._pending: deque[Future[None]] = deque()
        if handle is not None and self._parts:
            take_space(handle, -(-size // BLOCK) * BLOCK)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None and self._direct:
                self._end()
        finally:
            try:
                # Memory and file are in use until then.
                self._wait(0)
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
                if self._room is None:
                    self._room = _room()
                count = min(len(left), ROOM - self._at)
                self._room[self._at : self._at + count] = left[:count]
                self._at, left = self._at + count, left[count:]
                if self._at == ROOM:
                    self._send(self._room, ROOM)

    def _end(self) -> None:
        whole, size = -(-self._at // BLOCK) * BLOCK, self._begin + self._at
        if self._room is not None:
            self._room[self._at : whole] = 0
            self._send(self._room, whole)
        self._wait(0)
        self._file.truncate(size)

    def _send(self, room: np.ndarray, count: int) -> None:
        """Hand the next part, of so many bytes, to the disk."""
        given = room, count, self._begin
        self._room, self._at, self._begin = None, 0, self._begin + count
        if not self._parts:
            self._put(*given)
            return
        self._wait(self._parts - 1)
        self._pending.append(_threads().submit(self._put, *given))

    def _wait(self, most: int) -> None:
        """Wait until at most so many parts are on their way, or, where one fails, for all."""
        failed: BaseException | None = None
        while len(self._pending) > (most if failed is None else 0):
            error = self._pending.popleft().exception()
            failed = failed or error
        if failed is not None:
            raise failed

    def _put(self, room: np.ndarray, count: int, begin: int) -> None:
        try:
            put_at(self._file.fileno(), room[:count].data, begin)
        finally:
            _spare.append(room)


def put_at(handle: int, content: memoryview, begin: int) -> None:
    """Write bytes to a place in a file. One that is open past the cache, and cannot be so, goes by it from then on."""
    done, again = 0, False
    while done < len(content):
        try:
            done += os.pwrite(handle, content[done:], begin + done)
        except OSError as error:
            if error.errno != errno.EINVAL or again:
                raise
            # A disk of larger blocks.
            import fcntl

            again = True
            fcntl.fcntl(handle, fcntl.F_SETFL, fcntl.fcntl(handle, fcntl.F_GETFL) & ~os.O_DIRECT)


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


# Parts' memory that is used again, at the beginning of a page, as disks ask for.
_spare: list[np.ndarray] = []


def _room() -> np.ndarray:
    try:
        return _spare.pop()
    except IndexError:
        return fresh_pages(ROOM)


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(MOST_BESIDE, thread_name_prefix="sdm-disk")
