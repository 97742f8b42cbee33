"""Chains of the eight bricks of a cell, which grow side by side: a feature goes to those of the bricks it matters to.

Their last chunks and how full these are lie in a worker's stack, above all that waits there.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.culling.leaf_filter import FEATURE_STACK
from sdm.kernels.dense.chunk_pool import CHUNK, ROOM, CandidateLists, ChunkPool
from sdm.kernels.dense.counters import NEXT_CHUNK
from sdm.kernels.primitives.atomics import fetch_add_once

wp.set_module_options({"enable_backward": False})

BRICKS = 8
# In the stack: the chunk, the entries of it, and all entries of each brick's chain. Below are up to 31 features that
# wait, and the 224 of one batch.
CHUNKS, FILLS, LENGTHS = (FEATURE_STACK + 256 + BRICKS * i for i in range(3))


@wp.func
def begin_chains(pool: ChunkPool, stack: wp.array(dtype=wp.int32), lane: int, lanes: int):
    """Give each brick its first chunk; the number of the first is returned."""
    head = pool.reserved + fetch_add_once(pool.counters, NEXT_CHUNK, BRICKS, lane)
    brick = lane
    while brick < BRICKS:
        stack[CHUNKS + brick] = head + brick
        stack[FILLS + brick] = 0
        stack[LENGTHS + brick] = 0
        brick = brick + lanes
    return head


@wp.func_native(
    snippet=f"""
    wp::int32* const state = stack.data;
#if defined(__CUDA_ARCH__)
    const unsigned below = (1u << lane) - 1u;
    wp::int32 chunk_now = 0, fill_now = 0, added_now = 0;
    // Not written out eight times: code that does not fit into a GPU's cache has to be waited for.
    #pragma unroll 2
    for (int brick = 0; brick < {BRICKS}; ++brick) {{
        const bool keep = which >> brick & 1;
        const unsigned mask = __ballot_sync(0xffffffffu, keep);
        wp::int32 chunk = state[{CHUNKS} + brick], fill = state[{FILLS} + brick];
        const int added = __popc(mask), at = fill + __popc(mask & below);
        fill += added;
        wp::int32* to = entries.data + (size_t)chunk * {CHUNK} + at;
        bool put = keep & (chunk < chunks);
        if (fill > {ROOM} && chunk < chunks) {{
            wp::int32 fresh = 0;
            if (lane == 0) {{
                fresh = reserved + atomicAdd(counters.data + {NEXT_CHUNK}, 1);
                if (fresh < chunks) entries.data[(size_t)chunk * {CHUNK} + {ROOM}] = fresh;
            }}
            fresh = __shfl_sync(0xffffffffu, fresh, 0);
            if (at >= {ROOM}) {{
                put = put & (fresh < chunks);
                to = entries.data + (size_t)fresh * {CHUNK} + (at - {ROOM});
            }}
            chunk = fresh;
            fill -= {ROOM};
        }}
        if (put) *to = entry;
        if (lane == brick) {{
            chunk_now = chunk;
            fill_now = fill;
            added_now = added;
        }}
    }}
    __syncwarp();
    if (lane < {BRICKS}) {{
        state[{CHUNKS} + lane] = chunk_now;
        state[{FILLS} + lane] = fill_now;
        state[{LENGTHS} + lane] += added_now;
    }}
    __syncwarp();
#else
    for (unsigned left = which; left; left &= left - 1) {{
        const int brick = __builtin_ctz(left);
        wp::int32 &chunk = state[{CHUNKS} + brick], &fill = state[{FILLS} + brick];
        ++state[{LENGTHS} + brick];
        if (chunk >= chunks) continue;
        if (fill == {ROOM}) {{
            const wp::int32 fresh =
                reserved + __atomic_fetch_add(counters.data + {NEXT_CHUNK}, 1, __ATOMIC_RELAXED);
            if (fresh < chunks) entries.data[(size_t)chunk * {CHUNK} + {ROOM}] = fresh;
            chunk = fresh;
            fill = 0;
            if (fresh >= chunks) continue;
        }}
        entries.data[(size_t)chunk * {CHUNK} + fill++] = entry;
    }}
#endif
"""
)
def append_to(
    entries: wp.array(dtype=wp.int32),
    counters: wp.array(dtype=wp.int32),
    chunks: int,
    reserved: int,
    stack: wp.array(dtype=wp.int32),
    which: int,
    entry: int,
    lane: int,
):
    """Add each lane's entry to the chains of the bricks `which` (bits); as `chunk_pool.append` does."""
    ...


@wp.func
def end_chains(
    pool: ChunkPool,
    stack: wp.array(dtype=wp.int32),
    lists: CandidateLists,
    first: int,
    step: int,
    head: int,
    lane: int,
    lanes: int,
):
    """Note the bricks' chains as those numbered from `first` on in steps; `head` is negative for none.

    Returns how many chains of a lane's bricks are not complete.
    """
    lacking = int(0)
    brick = lane
    while brick < BRICKS:
        complete = head >= 0
        if complete:
            complete = stack[CHUNKS + brick] < pool.chunks
        lists.heads[first + step * brick] = wp.where(complete, head + brick, -1)
        lists.lengths[first + step * brick] = wp.where(complete, stack[LENGTHS + brick], 0)
        lacking = lacking + wp.where(complete, 0, 1)
        brick = brick + lanes
    return lacking
