"""Rooms of equal size in shared memory, which a GPU fills and worker processes read, one after the other."""

from __future__ import annotations

import queue
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, closing
from types import TracebackType
from typing import Self

import numpy as np
import torch

from sdm.runtime.file_space import give_space_back
from sdm.runtime.host_copy import pinned
from sdm.runtime.worker_processes.shared_memory import SharedMemory

# The system hands out fresh memory page by page as it is first touched, which takes longer than to pin it, and takes it
# back as slowly.
THREADS, PAGE = 4, 1 << 12
# Bytes that a thread touches at a time, so that the first room is there soon.
TOUCHED = 1 << 25


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
            self._threads = stack.enter_context(ThreadPoolExecutor(THREADS, thread_name_prefix="sdm-pin"))
            self._pins = {room.handle: stack.enter_context(ExitStack()) for room in self.all}
            self._stack = stack.pop_all()
        for room in self.all:
            if device.type != "cuda":
                self._free.put(room)
                continue
            parts = range(0, size, TOUCHED)
            touched = [self._threads.submit(_touch, room.content[part : part + TOUCHED]) for part in parts]
            self._threads.submit(self._pin, room, touched)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._stack:
            for done in [self._threads.submit(self._let_go, room) for room in self.all]:
                done.result()

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

    def _pin(self, room: SharedMemory, touched: Sequence[Future[None]]) -> None:
        wait(touched)
        try:
            self._pins[room.handle].enter_context(pinned(room.content, self._device))
        except RuntimeError as error:
            self._free.put(error)
        else:
            self._free.put(room)

    def _let_go(self, room: SharedMemory) -> None:
        self._pins[room.handle].close()
        give_space_back(room.handle, self.size)


def _touch(content: np.ndarray) -> None:
    content[::PAGE] = 0
