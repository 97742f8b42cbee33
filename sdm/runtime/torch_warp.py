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
from functools import lru_cache
from typing import Any

import torch
import warp as wp
from torch import Tensor

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
        stream = torch.cuda.current_stream()
        for read in reads:
            if read.numel():
                read.record_stream(stream)
        with _turn, wp.ScopedStream(warp_stream(tensor.device, stream), sync_enter=False):
            yield device


def warp_stream(device: torch.device, stream: torch.cuda.Stream) -> wp.Stream:
    """A stream of torch's for Warp."""
    return _warp_stream(wp.device_from_torch(device).alias, stream.cuda_stream)


@lru_cache(maxsize=64)
def _warp_stream(device: str, stream: int) -> wp.Stream:
    # Torch has a few streams, which it hands out again and again; Warp takes its time to look at one.
    return wp.Stream(device, cuda_stream=stream)


def as_warp(tensor: Tensor, dtype: Any) -> wp.array:
    """A contiguous torch tensor as a Warp array over the same memory, which the array does not keep."""
    inner = getattr(dtype, "_shape_", ())
    outer = tensor.shape[: tensor.ndim - len(inner)]
    size = wp.types.type_size_in_bytes(dtype)
    if tensor.shape != outer + inner or math.prod(inner) * tensor.itemsize != size or not tensor.is_contiguous():
        raise ValueError(
            f"a tensor of shape {tuple(tensor.shape)} and type {tensor.dtype} is no {dtype.__name__} array"
        )
    return array_at(tensor.data_ptr(), tuple(outer), dtype, tensor.device)


@lru_cache(maxsize=256)
def _prototype(dtype: Any, dimensions: int, device: torch.device) -> tuple[dict[str, Any], Any, int]:
    """The attributes of such an array, the type of its descriptor, and the bytes of an element."""
    array = wp.array(ptr=1, dtype=dtype, shape=(1,) * dimensions, device=wp.device_from_torch(device), copy=False)
    return vars(array), type(array.__ctype__()), wp.types.type_size_in_bytes(dtype)


@lru_cache(maxsize=1024)
def array_at(address: int, shape: tuple[int, ...], dtype: Any, device: torch.device) -> wp.array:
    """The contiguous Warp array at an address, which owns nothing.

    As `wp.array(ptr=address, ...)` makes it, but in a fifth of the time: a call needs dozens. What does not depend on
    the address and the shape is copied from another array of the type. And it may be remembered: torch's allocator
    gives the same few addresses again and again.
    """
    attributes, descriptor_type, step = _prototype(dtype, len(shape), device)
    attributes = attributes.copy()
    descriptor = descriptor_type.__new__(descriptor_type)
    descriptor.data, descriptor.ndim = address, len(shape)
    strides = []
    for axis in range(len(shape) - 1, -1, -1):
        descriptor.shape[axis], descriptor.strides[axis] = shape[axis], step
        strides.append(step)
        step *= shape[axis]
    attributes["ptr"], attributes["shape"], attributes["strides"] = address, shape, tuple(strides[::-1])
    attributes["size"], attributes["capacity"], attributes["ctype"] = math.prod(shape), step, descriptor
    array = object.__new__(wp.array)
    array.__dict__ = attributes
    return array


def version_of(tensor: Tensor) -> int | None:
    """Number of writes into a tensor that torch has counted; None if it counts none, as in inference mode."""
    return None if tensor.is_inference() else tensor._version


def workspace(device: torch.device) -> Callable[[int, Any], wp.array]:
    """An allocator of scratch arrays for kernels: torch's memory, kept for as long as the allocator lives."""
    kept: list[Tensor] = []
    free, end = 0, 0

    def empty(length: int, dtype: Any) -> wp.array:
        nonlocal free, end
        size = length * wp.types.type_size_in_bytes(dtype)
        alone = size > CHUNK // 4
        # Small arrays share a chunk: to ask torch for memory costs more than to count.
        if alone or free + size > end:
            kept.append(torch.empty(size if alone else CHUNK, dtype=torch.uint8, device=device))
            address = kept[-1].data_ptr()
            if alone:
                return array_at(address, (length,), dtype, device)
            free, end = address, address + CHUNK
        address = free
        free += size + -size % ALIGNMENT
        return array_at(address, (length,), dtype, device)

    return empty


def to_device(host: Tensor, device: torch.device) -> Tensor:
    """A small tensor of the host on a device, without waiting for it."""
    if device.type == "cpu":
        return host
    # Memory that is not pinned would make the copy wait for the host's side of it.
    return host.pin_memory().to(device, non_blocking=True)
