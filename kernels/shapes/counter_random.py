"""Counter-based random numbers in [0,1), which depend on a seed and an index alone: Philox and Sobol."""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.launch import launch, launch_grid

wp.set_module_options({"enable_backward": False})

# Numbers that one Philox block gives.
LANES = 4
# Bits of a Sobol point; after 2^30 points the sequence starts anew under another shift.
SOBOL_BITS = 30
_UNIT = 1.0 / 2.0**24
_MASK = wp.int64((1 << SOBOL_BITS) - 1)
_LAP = wp.int64(SOBOL_BITS)
_DROPPED = wp.int64(SOBOL_BITS - 24)
_ONE = wp.int64(1)
_NONE = wp.int64(0)
# Philox's multipliers and the steps of its keys. Not in the kernel, where a number is an int32 first: these are larger.
_MULTIPLIER_0, _MULTIPLIER_1 = wp.uint32(0xD2511F53), wp.uint32(0xCD9E8D57)
_WEYL_0, _WEYL_1 = wp.uint32(0x9E3779B9), wp.uint32(0xBB67AE85)
_WORD = wp.uint64(0xFFFFFFFF)


@wp.func
def mulhi(a: wp.uint32, b: wp.uint32):
    return wp.uint32((wp.uint64(a) * wp.uint64(b)) >> wp.uint64(32))


@wp.func
def philox(counter: wp.vec4ui, low: wp.uint32, high: wp.uint32):
    """Philox4x32-10 of Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011."""
    c0 = counter[0]
    c1 = counter[1]
    c2 = counter[2]
    c3 = counter[3]
    k0 = low
    k1 = high
    for _ in range(10):
        h0 = mulhi(_MULTIPLIER_0, c0)
        l0 = _MULTIPLIER_0 * c0
        h1 = mulhi(_MULTIPLIER_1, c2)
        l1 = _MULTIPLIER_1 * c2
        c0 = h1 ^ c1 ^ k0
        c1 = l1
        c2 = h0 ^ c3 ^ k1
        c3 = l0
        k0 = k0 + _WEYL_0
        k1 = k1 + _WEYL_1
    return wp.vec4ui(c0, c1, c2, c3)


@wp.func
def unit_float(bits: wp.uint32):
    """The upper 24 bits as a number in [0,1): exact in float32."""
    return float(bits >> wp.uint32(8)) * _UNIT


@wp.func
def counter_of(index: wp.int64, block: int, purpose: int):
    bits = wp.uint64(index)
    return wp.vec4ui(wp.uint32(bits & _WORD), wp.uint32(bits >> wp.uint64(32)), wp.uint32(block), wp.uint32(purpose))


@wp.kernel
def philox_kernel(
    low: wp.uint32, high: wp.uint32, purpose: int, index: wp.array(dtype=wp.int64), values: wp.array2d(dtype=wp.uint32)
):
    b, block = wp.tid()
    word = philox(counter_of(index[b], block, purpose), low, high)
    for lane in range(4):
        d = 4 * block + lane
        if d < values.shape[1]:
            values[b, d] = word[lane]


@wp.kernel
def uniform_kernel(
    begin: int, low: wp.uint32, high: wp.uint32, index: wp.array(dtype=wp.int64), values: wp.array2d(dtype=float)
):
    blocks = (values.shape[1] + 3) / 4
    place = begin + wp.tid()
    b = place / blocks
    block = place % blocks
    word = philox(counter_of(index[b], block, 0), low, high)
    for lane in range(4):
        d = 4 * block + lane
        if d < values.shape[1]:
            values[b, d] = unit_float(word[lane])


@wp.kernel
def sobol_kernel(
    low: wp.uint32,
    high: wp.uint32,
    index: wp.array(dtype=wp.int64),
    directions: wp.array2d(dtype=wp.int64),
    values: wp.array2d(dtype=float),
):
    b, d = wp.tid()
    position = index[b] & _MASK
    gray = position ^ (position >> _ONE)
    word = _NONE
    for k in range(SOBOL_BITS):
        if ((gray >> wp.int64(k)) & _ONE) != _NONE:
            word = word ^ directions[d, k]
    # One random shift of all points keeps their even spread and makes seeds differ.
    lap = index[b] >> _LAP
    shift = philox(counter_of(lap, d / 4, 1), low, high)
    word = word ^ wp.int64(shift[d % 4] >> wp.uint32(2))
    values[b, d] = float(word >> _DROPPED) * _UNIT


def fill_uniform(seed: int, index: Any, values: Any, device: Any) -> None:
    """Fill `values` (B,D) float32 with independent numbers in [0,1) for `index` (B,) int64."""
    blocks = -(-values.shape[1] // LANES)
    # Streams wait for this: one axis of threads, as such launches are recorded.
    launch(
        uniform_kernel, values.shape[0] * blocks, [seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF, index, values], device
    )


def fill_sobol(seed: int, index: Any, directions: Any, values: Any, device: Any) -> None:
    """Fill `values` (B,D) float32 with the points number `index` (B,) int64 of a shifted Sobol sequence.

    `directions` (D,30) int64 are the direction numbers of each axis.
    """
    inputs = [seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF, index, directions]
    launch_grid(sobol_kernel, dim=values.shape, inputs=inputs, outputs=[values], device=device)


def fill_words(seed: int, purpose: int, index: Any, values: Any, device: Any) -> None:
    """Fill `values` (B,D) uint32 with the raw words of Philox, for tests and for whole numbers."""
    blocks = -(-values.shape[1] // LANES)
    inputs = [seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF, purpose, index]
    launch_grid(philox_kernel, dim=(values.shape[0], blocks), inputs=inputs, outputs=[values], device=device)
