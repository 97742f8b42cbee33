"""Torch's memory and streams under Warp's kernels.

Warp frees its own arrays on the stream that is current when Python lets go of them, which may be another than the
one whose kernels still read them. All memory here is a torch tensor's instead: freed memory is reused only after the
work queued before it on its stream, and `record_stream` tells the allocator of every other stream that reads it. So
Warp's arrays own nothing, and a tensor has to live until the last kernel that uses it is queued, no longer.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch._C._functorch import is_functorch_wrapped_tensor
from torch.autograd import forward_ad

from sdm.kernels.launch import provide_zeros
from sdm.kernels.launches import arrays

# Arrays that share memory begin at multiples of this many bytes in it.
ALIGNMENT = 256
CHUNK = 1 << 20
# Warp's current stream is the device's, not the thread's.
_turn = threading.RLock()


@contextmanager
def on_current_stream(tensor: Tensor, *reads: Tensor) -> Iterator[wp.Device]:
    """Launch Warp kernels on torch's current stream of `tensor`'s device; `reads` stay alive until they are done."""
    device = wp.device_from_torch(tensor.device)
    if not device.is_cuda:
        yield device
        return
    with torch.cuda.device(tensor.device):
        # By its number, as torch looks for the current device otherwise.
        stream = torch.cuda.current_stream(tensor.device.index)
        for read in reads:
            if read.numel():
                read.record_stream(stream)
        with _turn, wp.ScopedStream(warp_stream(tensor.device, stream), sync_enter=False):
            yield device


def _raw_stream(index: int) -> int:
    return torch.cuda.current_stream(index).cuda_stream


# The handle of a GPU's current stream, 0 of its default one. Torch's own compiler asks so; an object takes as long as a
# launch.
raw_stream: Callable[[int], int] = getattr(torch._C, "_cuda_getCurrentRawStream", _raw_stream)
# The current GPU's number, where there is a tensor on one, and whether its current stream is being captured: without
# what torch does before it asks.
current_device: Callable[[], int] = getattr(torch._C, "_cuda_getDevice", torch.cuda.current_device)
is_capturing: Callable[[], bool] = getattr(
    torch._C, "_cuda_isCurrentStreamCapturing", torch.cuda.is_current_stream_capturing
)


def warp_stream(device: torch.device, stream: torch.cuda.Stream) -> wp.Stream:
    """A stream of torch's for Warp."""
    return _warp_stream(wp.device_from_torch(device).alias, stream.cuda_stream)


@lru_cache(maxsize=64)
def _warp_stream(device: str, stream: int) -> wp.Stream:
    # Torch has a few streams, which it hands out again and again; Warp takes its time to look at one.
    return wp.Stream(device, cuda_stream=stream)


def as_warp(tensor: Tensor, dtype: Any) -> wp.array:
    """A contiguous torch tensor as a Warp array over the same memory, which the array does not keep."""
    shape = tuple(tensor.shape)
    inner, size = _inner(dtype)
    if inner:
        outer = shape[: len(shape) - len(inner)]
        fits = shape == outer + inner and math.prod(inner) * tensor.itemsize == size
    else:
        outer, fits = shape, tensor.itemsize == size
    if not (fits and tensor.is_contiguous()):
        raise ValueError(f"a tensor of shape {shape} and type {tensor.dtype} is no {dtype.__name__} array")
    return arrays.array_at(tensor.data_ptr(), outer, dtype, warp_name(tensor.device))


@cache
def _inner(dtype: Any) -> tuple[tuple[int, ...], int]:
    """Shape of a vector or matrix, and bytes."""
    return tuple(getattr(dtype, "_shape_", ())), arrays.size_of(dtype)


@cache
def warp_name(device: torch.device) -> str:
    """Warp's name of a torch device."""
    return str(wp.device_from_torch(device).alias)


def array_at(address: int, shape: tuple[int, ...], dtype: Any, device: torch.device) -> wp.array:
    """The contiguous Warp array at an address, which owns nothing."""
    return arrays.array_at(address, shape, dtype, warp_name(device))


def repeated_row(array: wp.array, rows: int) -> wp.array:
    """The array (1,n) as one of so many rows, all over the same memory."""
    step: Any = array.strides[1]
    return wp.array(
        ptr=array.ptr,
        dtype=array.dtype,
        shape=(rows, array.shape[1]),
        strides=(0, step),
        device=array.device,
        copy=False,
    )


def version_of(tensor: Tensor) -> int | None:
    """Number of writes into a tensor that torch has counted; None if it counts none, as in inference mode."""
    return None if tensor.is_inference() else tensor._version


def has_forward_mode() -> bool:
    """True where a tensor may have a forward-mode derivative at all."""
    return getattr(forward_ad, "_current_level", 0) >= 0


def refuse_other_modes(tensor: Tensor) -> None:
    """Refuse a tensor that kernels would misread: one with a forward-mode derivative, or of a transform of torch.func.

    After Warp's kernels torch would take the derivative for zero, and of transforms it says nothing that helps.
    """
    if torch.compiler.is_compiling():
        return
    # Nearly always there is no level of it.
    if getattr(forward_ad, "_current_level", 0) >= 0 and forward_ad.unpack_dual(tensor).tangent is not None:
        raise NotImplementedError(
            "signed distances have derivatives in reverse mode alone: use backward() in place of jvp"
        )
    if is_functorch_wrapped_tensor(tensor):
        raise NotImplementedError(
            "torch.func's transforms do not go through signed distances: in place of vmap give points of any shape "
            "(...,3), in place of grad and jacrev use backward() or torch.autograd.functional.jacobian"
        )


def workspace(device: torch.device, zeros: Tensor | None = None) -> Callable[[int, Any], wp.array]:
    """An allocator of workspace for kernels: torch's memory, kept for as long as the allocator lives.

    Of `zeros` (n,) int32, if there are any, `sdm.kernels.launch.new_zeros` takes its own.
    """
    kept: list[Tensor] = []
    free, end, name = 0, 0, warp_name(device)

    def empty(length: int, dtype: Any) -> wp.array:
        nonlocal free, end
        size = length * arrays.size_of(dtype)
        alone = size > CHUNK // 4
        # Small arrays share a chunk: to ask torch for memory costs more than to count.
        if alone or free + size > end:
            kept.append(torch.empty(size if alone else CHUNK, dtype=torch.uint8, device=device))
            address = kept[-1].data_ptr()
            if alone:
                return arrays.array_at(address, (length,), dtype, name)
            free, end = address, address + CHUNK
        address = free
        free += size + -size % ALIGNMENT
        return arrays.array_at(address, (length,), dtype, name)

    if zeros is not None:
        kept.append(zeros)
        provide_zeros(empty, as_warp(zeros, wp.int32))
    return empty


def to_device(host: Tensor, device: torch.device) -> Tensor:
    """A small tensor of the host on a device, without waiting for it."""
    if device.type == "cpu":
        return host
    # Memory that is not pinned would make the copy wait for the host's side of it.
    return host.pin_memory().to(device, non_blocking=True)
