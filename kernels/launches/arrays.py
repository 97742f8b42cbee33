"""Warp arrays over memory that others own, made in a fraction of the time that `wp.array(ptr=...)` takes.

What does not depend on the address and the length is copied from another array of the type, and the descriptor that
kernels read is packed at once.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

import warp as wp

# `warp.types.array_t`: data, gradient, shape and strides of four axes, number of axes, flags.
_DESCRIPTOR = struct.Struct("=QQ8iHHxxxx")
_pack = _DESCRIPTOR.pack
_new = object.__new__
LARGEST_STRIDE = (1 << 31) - 1


@cache
def size_of(dtype: Any) -> int:
    """Bytes of an element."""
    return int(wp.types.type_size_in_bytes(dtype))


@cache
def _prototype(dtype: Any, dimensions: int, device: str) -> tuple[dict[str, Any], Any, int]:
    """The attributes of such an array, the type of its descriptor, and the bytes of an element."""
    array = wp.array(ptr=1, dtype=dtype, shape=(1,) * dimensions, device=device, copy=False)
    descriptor = array.__ctype__()
    attributes = dict(vars(array))
    # Of another version of Warp nobody knows how a descriptor is packed.
    size, ones = size_of(dtype), (1,) * dimensions + (0,) * (4 - dimensions)
    strides = (size,) * dimensions + (0,) * (4 - dimensions)
    if bytes(descriptor)[:52] != _pack(1, 0, *ones, *strides, dimensions, 0)[:52]:
        raise RuntimeError(f"Warp {wp.__version__} describes arrays otherwise than this package was made for")
    return attributes, type(descriptor), size


def array_at(address: int, shape: tuple[int, ...], dtype: Any, device: str) -> wp.array:
    """The contiguous array at an address, of up to four axes; `device` is the alias of Warp's."""
    known, descriptor, step = _prototype(dtype, len(shape), device)
    if len(shape) == 1:
        # Nearly all are.
        size, strides = shape[0], (step,)
        nbytes = size * step
        packed = _pack(address, 0, size, 0, 0, 0, step, 0, 0, 0, 1, 0)
    else:
        nbytes, strides, rest = step, (), (0,) * (4 - len(shape))
        for length in reversed(shape):
            strides = (nbytes, *strides)
            nbytes *= length
        size = nbytes // step
        kept = strides if strides[0] <= LARGEST_STRIDE else _kept(strides, shape)
        packed = _pack(address, 0, *shape, *rest, *kept, *rest, len(shape), 0)
    attributes = known.copy()
    attributes["ptr"], attributes["shape"], attributes["strides"] = address, shape, strides
    attributes["size"], attributes["capacity"] = size, nbytes
    attributes["ctype"] = descriptor.from_buffer_copy(packed)
    array = _new(wp.array)
    array.__dict__ = attributes
    return array


def _kept(strides: tuple[int, ...], shape: tuple[int, ...]) -> tuple[int, ...]:
    """The strides as 32 bits hold them: nothing steps along an axis of one element, so that its stride is free."""
    if any(stride > LARGEST_STRIDE and length > 1 for stride, length in zip(strides, shape, strict=True)):
        raise ValueError(f"an array of shape {shape} has strides of more than {LARGEST_STRIDE:,} bytes: split it")
    return tuple(min(stride, LARGEST_STRIDE) for stride in strides)


# Keys of no more bits may be int32, where they stay positive.
SHORT_BITS = 31
# Pairs of an int64 and an int32, and of two int32, that a GPU sorts in one block; and so many that bytes decide.
_ONE_LONG_BLOCK, _ONE_SHORT_BLOCK, _MANY = 2304, 4864, 600_000


def short_keys(count: int, bits: int) -> bool:
    """True if a GPU sorts so many keys of so many bits more quickly as int32 than as int64.

    Between a block and many keys it has more blocks of the longer ones, which take a tenth less for it
    (bench/decisions/0050-kernels-of-meshes-alike.md).
    """
    return bits <= SHORT_BITS and (_ONE_LONG_BLOCK < count <= _ONE_SHORT_BLOCK or count >= _MANY)
