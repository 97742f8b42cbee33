"""Atomic operations, on numbers that many threads change at the same time.

Warp's own atomics are plain additions on a CPU, where `launch` runs a kernel on several threads.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return atomicAdd(counts.data + index, value);
#else
    return __atomic_fetch_add(counts.data + index, value, __ATOMIC_RELAXED);
#endif
"""
)
def fetch_add(counts: wp.array(dtype=wp.int32), index: int, value: int) -> int:
    """Add to a count that other threads add to as well; returns what it was before."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    atomicMin(values.data + index, value);
#else
    int* at = values.data + index;
    int before = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (value < before && !__atomic_compare_exchange_n(at, &before, value, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED))
        ;
#endif
"""
)
def keep_least(values: wp.array(dtype=wp.int32), index: int, value: int):
    """Bring a value down to another if it is larger, while others do the same."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return atomicMin(values.data + index, value);
#else
    int* at = values.data + index;
    int before = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (value < before && !__atomic_compare_exchange_n(at, &before, value, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED))
        ;
    return before;
#endif
"""
)
def fetch_least(values: wp.array(dtype=wp.int32), index: int, value: int) -> int:
    """`keep_least` that returns what the value was before."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    atomicAdd(values.data + index, value);
#else
    long long* at = reinterpret_cast<long long*>(values.data) + index;
    union { long long i; double f; } before, after;
    before.i = __atomic_load_n(at, __ATOMIC_RELAXED);
    do
        after.f = before.f + value;
    while (!__atomic_compare_exchange_n(at, &before.i, after.i, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED));
#endif
"""
)
def add_double(values: wp.array(dtype=wp.float64), index: int, value: wp.float64):
    """Add to a number that other threads add to as well, in any order."""
    ...


@wp.func_native(
    snippet="""
    // Floats without a sign are in the order of their bits, those with one in the other order.
    int* at = reinterpret_cast<int*>(values.data) + index;
    const int bits = *reinterpret_cast<int*>(&value);
#if defined(__CUDA_ARCH__)
    if (bits >= 0)
        atomicMin(at, bits);
    else
        atomicMax(reinterpret_cast<unsigned*>(at), (unsigned)bits);
#else
    union { int i; float f; } now;
    now.i = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (value < now.f && !__atomic_compare_exchange_n(at, &now.i, bits, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED))
        ;
#endif
"""
)
def lessen(values: wp.array(dtype=wp.float32), index: int, value: float):
    """Bring a value down to another if it is larger, while others do the same."""
    ...


@wp.func_native(
    snippet="""
    // With the sign bit the same, floats are ordered by magnitude as their bits are.
    unsigned* at = reinterpret_cast<unsigned*>(values.data) + index;
    const unsigned bits = (*at & 0x80000000u) | (0x7fffffffu & *reinterpret_cast<unsigned*>(&size));
#if defined(__CUDA_ARCH__)
    atomicMin(at, bits);
#else
    unsigned before = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (bits < before && !__atomic_compare_exchange_n(at, &before, bits, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED))
        ;
#endif
"""
)
def shrink(values: wp.array(dtype=wp.float32), index: int, size: float):
    """Bring a value's magnitude down to `size` if it is larger, while others do the same; its sign stays."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    int item = 0;
    if (lane == 0)
        item = atomicAdd(counts.data + index, value);
    return __shfl_sync(0xffffffffu, item, 0);
#else
    return __atomic_fetch_add(counts.data + index, value, __ATOMIC_RELAXED);
#endif
"""
)
def fetch_add_once(counts: wp.array(dtype=wp.int32), index: int, value: int, lane: int) -> int:
    """`fetch_add` by one lane for the whole group; every lane gets the result."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    __threadfence();
    int before = atomicAdd(counts.data + index, 1);
    __threadfence();
    return before;
#else
    return __atomic_fetch_add(counts.data + index, 1, __ATOMIC_ACQ_REL);
#endif
"""
)
def arrive(counts: wp.array(dtype=wp.int32), index: int) -> int:
    """Add one to a count; whoever finds that all others have been there sees what they had written before."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    // Not an addition: a compiler would add for all lanes at once, and has them wait for what comes of it.
    return lane == 0 ? atomicInc(reinterpret_cast<unsigned*>(counts.data + index), 0x7fffffffu) : 0;
#else
    return __atomic_fetch_add(counts.data + index, 1, __ATOMIC_RELAXED);
#endif
"""
)
def ask_for_next(counts: wp.array(dtype=wp.int32), index: int, lane: int) -> int:
    """`fetch_add_once` of 1 whose result the first lane alone gets, and does not wait for before it is looked at."""
    ...
