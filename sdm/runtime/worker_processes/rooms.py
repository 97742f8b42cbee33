"""Rooms of equal size in shared memory, which a GPU fills and worker processes read, one after the other."""

from __future__ import annotations

import queue
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from types import TracebackType
from typing import Self

import torch

from sdm.runtime.host_copy import pinned
from sdm.runtime.worker_processes.shared_memory import SharedMemory

# The system hands out fresh memory page by page as it is first touched, which takes longer than to pin it.
THREADS, PAGE = 4, 1 << 12


class SharedRooms:
    """Rooms that are handed out and given back, from any thread; a context manager.

    Args:
        count: How many.
        size: Bytes of each.
        device: Of what fills them. For a GPU they are pinned, while the first ones are in use.

    Raises:
        OSError: The system has no such memory.
    """

    def __init__(self, count: int, size: int, device: torch.device) -> None:
        self._free: queue.SimpleQueue[SharedMemory | RuntimeError] = queue.SimpleQueue()
        self.size, self._device = size, device
        with ExitStack() as stack:
            self.all = [stack.enter_context(closing(SharedMemory(size))) for _ in range(count)]
            self._pins = stack.enter_context(ExitStack())
            threads = stack.enter_context(ThreadPoolExecutor(THREADS, thread_name_prefix="sdm-pin"))
            self._stack = stack.pop_all()
        for room in self.all:
            threads.submit(self._prepare, room)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def take(self) -> SharedMemory:
        """A room that is free, once there is one.

        Raises:
            RuntimeError: CUDA cannot pin so much.
        """
        found = self._free.get()
        if isinstance(found, RuntimeError):
            raise found
        return found

    def give(self, room: SharedMemory) -> None:
        """A room is free again."""
        self._free.put(room)

    def _prepare(self, room: SharedMemory) -> None:
        try:
            if self._device.type == "cuda":
                room.content[::PAGE] = 0
                self._pins.enter_context(pinned(room.content, self._device))
        except RuntimeError as error:
            self._free.put(error)
        else:
            self._free.put(room)
