"""Copies from a GPU to the host that nobody waits for until they are read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

T = TypeVar("T")


class HostCopy(Generic[T]):
    """A tensor on its way to the host, and what is made of it there.

    Args:
        values: On any device. From a GPU it is copied into pinned memory by a stream of its own, beside the kernels
            that are queued next.
        make: Makes of the tensor on the host what `wait` returns.
        memory: (n,) bytes to copy it into, `pinned` for a GPU; fresh ones by default.

    Another thread may wait; it holds nothing up but itself.
    """

    def __init__(self, values: Tensor, make: Callable[[Tensor], T], *, memory: np.ndarray | None = None) -> None:
        self._make = make
        self._done: torch.cuda.Event | None = None
        if values.device.type != "cuda":
            self._host = values.detach()
            if memory is not None:
                self._host = _tensor_in(memory, values.shape, values.dtype).copy_(self._host)
            return
        if memory is None:
            self._host = torch.empty(values.shape, dtype=values.dtype, device="cpu", pin_memory=True)
        else:
            self._host = _tensor_in(memory, values.shape, values.dtype)
        side = _copy_stream(values.device)
        side.wait_stream(torch.cuda.current_stream(values.device))
        with torch.cuda.stream(side):
            self._host.copy_(values.detach(), non_blocking=True)
            # Threads that hand maps on are many, and would take a core each to wait for one.
            self._done = torch.cuda.Event(blocking=memory is not None)
            self._done.record(side)
        # Its memory is not given to others before the copy has read it.
        values.record_stream(side)

    def is_there(self) -> bool:
        """True if `wait` would not wait."""
        return self._done is None or self._done.query()

    def wait(self) -> T:
        """The thing that was made of the tensor, once it is there."""
        if self._done is not None:
            self._done.synchronize()
        return self._make(self._host)


def number_later(numbers: Tensor, at: int = 0) -> Callable[[], int]:
    """A function that reads one number of a tensor (n,), which waits for the work of the stream that is current now."""
    if numbers.device.type != "cuda":
        return partial(_number, numbers, at)
    return partial(_number_by, torch.cuda.current_stream(numbers.device), numbers, at)


def _number(numbers: Tensor, at: int) -> int:
    return int(numbers[at])


def _number_by(stream: torch.cuda.Stream, numbers: Tensor, at: int) -> int:
    with torch.cuda.stream(stream):
        return int(numbers[at])


def numbers_of(values: Tensor) -> Callable[[], list[int]]:
    """Numbers of a tensor, once they are there: they are copied now, on the current stream.

    What is queued after this is not waited for.
    """
    if values.device.type != "cuda":
        return values.tolist
    host = torch.empty(values.shape, dtype=values.dtype, device="cpu", pin_memory=True)
    host.copy_(values, non_blocking=True)
    done = torch.cuda.Event()
    done.record(torch.cuda.current_stream(values.device))

    def wait() -> list[int]:
        done.synchronize()
        return host.tolist()

    return wait


class HostRows:
    """Rows on the host that are filled by copies from a device, which nobody waits for until they are read.

    Args:
        shape: Of all rows together.
        dtype: Their type.
        device: Where they come from. From a GPU they are copied into pinned memory by a stream of its own.
        memory: (n,) bytes to begin them in, `pinned` for a GPU; fresh ones by default.
    """

    def __init__(
        self, shape: tuple[int, ...], dtype: torch.dtype, device: torch.device, *, memory: np.ndarray | None = None
    ) -> None:
        self._gpu = device if device.type == "cuda" else None
        if memory is None:
            self._rows = torch.empty(shape, dtype=dtype, device="cpu", pin_memory=self._gpu is not None)
        else:
            self._rows = _tensor_in(memory, shape, dtype)
        self._done: torch.cuda.Event | None = None

    def put(self, begin: int, values: Tensor) -> None:
        """Fill the rows from `begin` on with values (n,...) on the device."""
        rows = self._rows[begin : begin + len(values)]
        if self._gpu is None:
            rows.copy_(values)
            return
        side = _copy_stream(self._gpu)
        side.wait_stream(torch.cuda.current_stream(self._gpu))
        with torch.cuda.stream(side):
            rows.copy_(values, non_blocking=True)
            # Threads that wait take no core.
            self._done = torch.cuda.Event(blocking=True)
            self._done.record(side)
        values.record_stream(side)

    def wait(self) -> np.ndarray:
        """All rows, once they are there."""
        if self._done is not None:
            self._done.synchronize()
        return self._rows.numpy()


def _tensor_in(memory: np.ndarray, shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
    return torch.from_numpy(memory[: math.prod(shape) * dtype.itemsize]).view(dtype).view(shape)


@cache
def _copy_stream(device: torch.device) -> torch.cuda.Stream:
    return torch.cuda.Stream(device)


@contextmanager
def pinned(memory: np.ndarray, device: torch.device) -> Iterator[None]:
    """While the block runs, bytes (n,) of the host are where a GPU copies to by itself.

    Raises:
        RuntimeError: CUDA cannot pin so much.
    """
    cuda: Any = torch.cuda.cudart()
    with torch.cuda.device(device):
        torch.cuda.check_error(cuda.cudaHostRegister(memory.ctypes.data, memory.nbytes, 0))
    try:
        yield
    finally:
        # A copy of work that was cut off may be on its way.
        _copy_stream(device).synchronize()
        torch.cuda.check_error(cuda.cudaHostUnregister(memory.ctypes.data))
