"""Choice of the device, and its free memory."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from sdm.errors import DeviceError, GridError

# Bytes that fit, and the part of a GPU's memory that is not asked about beforehand.
SMALL, SHARE_UNASKED = 1 << 26, 64
# Bytes, more than any machine has.
UNKNOWN_MEMORY = 1 << 62


def choose_device(wanted: str | torch.device | None, *tensors: Tensor | None) -> torch.device:
    """The device to compute on.

    Args:
        wanted: A device's name. None or `"auto"`: where the first of `tensors` on a GPU is, else a GPU if there is
            one, else the CPU.
        tensors: What is to be computed with.

    Raises:
        DeviceError: The device is not there.
    """
    if wanted is None or wanted == "auto":
        for tensor in tensors:
            if tensor is not None and tensor.is_cuda:
                return tensor.device
        return torch.device("cuda", torch.cuda.current_device()) if torch.cuda.is_available() else torch.device("cpu")
    try:
        device = torch.device(wanted)
    except (RuntimeError, TypeError):
        raise _unknown(wanted) from None
    if device.type not in ("cpu", "cuda"):
        raise DeviceError(f"the device {wanted} is not supported; use cpu, cuda or cuda:N")
    if device.type == "cpu":
        return device
    # Where a tensor is, there is a device. To look for it takes as long as a few kernels.
    there = False
    for tensor in tensors:
        there = there or (tensor is not None and tensor.is_cuda and device.index in (None, tensor.device.index))
    if not there:
        _require_cuda(device)
    return torch.device("cuda", torch.cuda.current_device()) if device.index is None else device


def device_to_hold(wanted: str | torch.device) -> torch.device:
    """A device that is to hold tensors, of any kind that torch has.

    Raises:
        DeviceError: There is none of that name.
    """
    try:
        device = torch.device(wanted)
    except (RuntimeError, TypeError):
        raise _unknown(wanted) from None
    if device.type == "cuda":
        _require_cuda(device)
    return device


def _unknown(wanted: object) -> DeviceError:
    name = repr(wanted) if isinstance(wanted, str) else f"by an object of type {type(wanted).__name__}"
    return DeviceError(f"there is no device called {name}; use cpu, cuda or cuda:N")


def _require_cuda(device: torch.device) -> None:
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if count == 0:
        raise DeviceError(f"the device {device} was requested, but no CUDA device is there; use cpu")
    if device.index is not None and device.index >= count:
        raise DeviceError(f"the device {device} was requested, but there are only cuda:0 to cuda:{count - 1}")


def free_memory(device: torch.device) -> int:
    """Bytes that a new tensor on `device` may take: free memory, and what torch keeps for reuse."""
    if device.type == "cuda":
        free, _ = torch.cuda.mem_get_info(device)
        return free + torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable"):
                return 1024 * int(line.split()[1])
    except OSError:
        pass
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        # Windows does not say so to the standard library: nothing is refused there before it is tried.
        return UNKNOWN_MEMORY


def require_memory(needed: int, device: torch.device, what: str) -> None:
    """Refuse what cannot fit, before hours of work and a crash.

    Raises:
        GridError: Says how much is needed and how much there is.
    """
    # Small things fit, and asking costs time.
    if needed < SMALL or torch.compiler.is_compiling():
        return
    _refuse_beyond(free_memory(device), needed, device, what)


@cache
def total_memory(device: torch.device) -> int:
    """Bytes that a GPU has."""
    return torch.cuda.get_device_properties(device).total_memory


class memory_guard(AbstractContextManager[None]):  # noqa: N801
    """Refuse what cannot fit, as `require_memory`, but of a GPU's memory only what is large is asked about beforehand.

    To ask a GPU takes as long as many a map. What turns out not to fit is refused with the same sentence.

    Args:
        needed: Bytes.
        device: Of the memory.
        what: What needs them, or a function that says so.
    """

    # Not by `contextmanager`, which takes the host longer than the rest of it.
    __slots__ = ("_device", "_needed", "_what")

    def __init__(self, needed: int, device: torch.device, what: str | Callable[[], str]) -> None:
        self._needed, self._device, self._what = needed, device, what
        unasked = SMALL if device.type != "cuda" else total_memory(device) // SHARE_UNASKED + 1
        if needed >= unasked and not torch.compiler.is_compiling():
            require_memory(needed, device, self._name())

    def _name(self) -> str:
        return self._what if isinstance(self._what, str) else self._what()

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: object) -> None:
        if kind is not None and issubclass(kind, torch.OutOfMemoryError) and self._device.type == "cuda":
            _refuse_beyond(free_memory(self._device), self._needed, self._device, self._name())


@contextmanager
def plain_defaults() -> Iterator[None]:
    """float32 on the host, whatever torch's default type and device are the caller's: networks are made by them."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        with torch.device("cpu"):
            yield
    finally:
        torch.set_default_dtype(before)


def gibibytes(count: int) -> str:
    """A number of bytes in words; of very many three digits are enough."""
    return f"{count / 2**30:.1f} GiB" if count < 2**50 else f"{count / 2**30:.3g} GiB"


def _refuse_beyond(free: int, needed: int, device: torch.device, what: str) -> None:
    if needed > free:
        raise GridError(
            f"{what} needs {gibibytes(needed)}, but {device} has {gibibytes(free)} free; "
            "choose a lower resolution, or write a .zarr file, which goes slab by slab"
        )
