"""Output slots: maps written to an address that is known only when a recording of their call is launched.

A CUDA graph writes to the same memory each time, while a result must be a new one each time, and copying takes a
twentieth of the time that it takes to make a large map. So while a call is recorded its kernels are told to take the
address of the map from memory, and each launch puts it there.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor


class OutputSlot:
    """The address that the map of a recorded call is written to."""

    def __init__(self, device: torch.device) -> None:
        self.address = torch.zeros(1, dtype=torch.int64, device=device)
        self._shape: torch.Size | None = None

    def bind(self, values: Tensor) -> Tensor:
        """The address, in memory, for kernels that would fill `values`."""
        if self._shape is not None:
            raise RuntimeError("a recorded call has one map")
        self._shape = values.shape
        return self.address

    def new_output(self) -> Tensor | None:
        """A new map, which the next launch on the current stream will fill; None if the call makes none."""
        if self._shape is None:
            return None
        values = torch.empty(self._shape, dtype=torch.float32, device=self.address.device)
        self.address.fill_(values.data_ptr())
        return values


class _Current(threading.local):
    slot: OutputSlot | None = None


_current = _Current()


@contextmanager
def capturing_into(slot: OutputSlot) -> Iterator[None]:
    """Maps that this thread makes meanwhile are written to `slot`."""
    _current.slot = slot
    try:
        yield
    finally:
        _current.slot = None


def current_slot() -> OutputSlot | None:
    """The slot of the call that is being recorded by this thread."""
    return _current.slot
