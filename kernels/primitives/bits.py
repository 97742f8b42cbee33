"""Bits of whole numbers: counted, found, and set by many threads at the same time."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    atomicOr(words.data + index, mask);
#else
    __atomic_fetch_or(words.data + index, mask, __ATOMIC_RELAXED);
#endif
"""
)
def set_bits(words: wp.array(dtype=wp.int32), index: int, mask: int):
    """Set the bits of a mask in a word, while others do the same."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __popc(word);
#else
    return __builtin_popcount((unsigned)word);
#endif
"""
)
def members_of(word: int) -> int:
    """Number of bits that are set."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __ffs(word) - 1;
#else
    return __builtin_ctz((unsigned)word);
#endif
"""
)
def first_of(word: int) -> int:
    """Number of the lowest bit that is set, of a word that has one."""
    ...


@wp.func_native(snippet="return (int)((unsigned)word & ((unsigned)word - 1u));")
def without_first(word: int) -> int:
    """The word without the lowest bit that is set."""
    ...
