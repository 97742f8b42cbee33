"""Queues of work, from which all lanes get some: octants that features matter to, and eighths of those.

A pair is a feature's number (5 bits) and one of the block's octants of 4^3 voxels (3 bits); an item is a pair and one
of that octant's eighths of 2^3 voxels (3 bits). Each lane finds a few of them or none; then each takes one.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

FEATURE_BITS, PAIR_BITS = 5, 8


def one_for_each_bit(queue: str, entry: str) -> str:
    """Native text that puts an `entry` for each `bit` that a lane has in `which` into a `queue`, from its place `top`.

    Returns the place after the last lane's.
    """
    return f"""
    {queue}
#if defined(__CUDA_ARCH__)
    const int mine = __popc(which);
    int upto = mine;
    #pragma unroll
    for (int step = 1; step < 32; step <<= 1)
        // A shuffle says itself which lanes have one before.
        asm volatile("{{ .reg .s32 before; .reg .pred there; shfl.sync.up.b32 before|there, %0, %1, 0, -1;"
                     "@there add.s32 %0, %0, before; }}" : "+r"(upto) : "r"(step));
    auto at = queue + (top + upto - mine);
    #pragma unroll 1
    for (unsigned left = which; left; left &= left - 1) {{
        const int bit = __ffs(left) - 1;
        *at++ = {entry};
    }}
    return top + __shfl_sync(0xffffffffu, upto, 31);
#else
    for (unsigned left = which; left; left &= left - 1) {{
        const int bit = __builtin_ctz(left);
        queue[top++] = {entry};
    }}
    return top;
#endif
"""


@wp.func_native(
    snippet=one_for_each_bit(
        "unsigned short* queue = reinterpret_cast<unsigned short*>(scratch) + begin / 2;",
        "(unsigned short)(tag | bit << bits)",
    )
)
def enqueue(scratch: wp.uint64, begin: int, top: int, tag: int, bits: int, which: int, lane: int) -> int:
    """Put the lanes' boxes `which` of `tag`, a number of so many `bits`, into the queue that begins at byte `begin`.

    There are `top` others; returns how many there are now.
    """
    ...


@wp.func_native(snippet="return reinterpret_cast<const unsigned short*>(scratch)[begin / 2 + at];")
def queue_entry(scratch: wp.uint64, begin: int, at: int) -> int:
    """Entry of a queue, by its place."""
    ...
