"""A group of lanes that works on one item: the 32 threads of a warp on a GPU, one thread on a CPU.

Kernels written with these few functions, and those of `atomics` and `vector_loads`, run the same algorithm on both.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

GPU_LANES = 32
# Thread blocks, of 128 threads, that a multiprocessor holds at a time; the compiler shares out registers by it.
BLOCKS_PER_SM = 4
# Groups of lanes in a thread block.
GPU_GROUPS = 4


def gpu_workers(device: wp.Device, blocks_per_sm: int) -> int:
    """Groups of lanes at work at a time on a GPU, by the thread blocks of a kernel that a multiprocessor holds."""
    return device.sm_count * GPU_GROUPS * blocks_per_sm


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return false;
#else
    return true;
#endif
"""
)
def on_cpu() -> bool:
    """True on a CPU. Known when a kernel is compiled, so that what is not for the device costs it nothing."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return lanes;
#else
    return 1;
#endif
"""
)
def one_on_cpu(lanes: int) -> int:
    """A number of lanes: on a CPU one, and its compiler knows that."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    asm volatile("" : "+r"(count));
#endif
    return count;
"""
)
def unknown(count: int) -> int:
    """A number that a GPU's compiler does not know, so that it does not write out a loop of so many turns.

    What a multiprocessor works at must fit into its cache for instructions: bench/decisions/0001-kernel-code-size.md.
    """
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __ballot_sync(0xffffffffu, keep);
#else
    return keep ? 1u : 0u;
#endif
"""
)
def ballot(keep: bool) -> wp.uint32:
    """One bit for each lane of the group."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __popc(mask & ((1u << lane) - 1u));
#else
    return 0;
#endif
"""
)
def rank(mask: wp.uint32, lane: int) -> int:
    """Number of lanes before this one that are in the mask."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __popc(mask);
#else
    return mask;
#endif
"""
)
def members(mask: wp.uint32) -> int:
    """Number of lanes in the mask."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __ballot_sync(0xffffffffu, keep) >> (lane & ~(some - 1)) & (0xffffffffu >> (32 - some));
#else
    return keep ? 1u : 0u;
#endif
"""
)
def ballot_of_some(keep: bool, lane: int, some: int) -> wp.uint32:
    """One bit for each of a lane's part of the group, of so many neighbours, a power of two. All lanes have to ask."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 1; step < some; step <<= 1)
        bits |= __shfl_xor_sync(0xffffffffu, bits, step);
#endif
    return bits;
"""
)
def bits_of_some(bits: int, some: int) -> int:
    """The bits that any of each so many neighbouring lanes has, the same for each of these."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1)
        bits |= __shfl_xor_sync(0xffffffffu, bits, step);
#endif
    return bits;
"""
)
def bits_of_lanes(bits: int) -> int:
    """The bits that any lane has, the same for each."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __ffs(mask) - 1;
#else
    return 0;
#endif
"""
)
def first_member(mask: wp.uint32) -> int:
    """The first lane in the mask, which must not be empty."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    unsigned long long key = ((unsigned long long)__float_as_uint(value) << 32) | (unsigned)lane;
    for (int step = 16; step > 0; step >>= 1) {
        unsigned long long other = __shfl_xor_sync(0xffffffffu, key, step);
        key = other < key ? other : key;
    }
    return key & 31u;
#else
    return 0;
#endif
"""
)
def lane_of_least(value: float, lane: int) -> int:
    """The lane with the least value; values must not be negative."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1)
        value = fminf(value, __shfl_xor_sync(0xffffffffu, value, step));
#endif
    return value;
"""
)
def least_of_lanes(value: float) -> float:
    """The least of all lanes' values, the same for each."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1)
        value = min(value, __shfl_xor_sync(0xffffffffu, value, step));
#endif
    return value;
"""
)
def least_whole_of_lanes(value: int) -> int:
    """The least of all lanes' whole numbers, the same for each."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1)
        value += __shfl_xor_sync(0xffffffffu, value, step);
#endif
    return value;
"""
)
def sum_of_lanes(value: float) -> float:
    """The sum of all lanes' values, the same for each."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1)
        value += __shfl_xor_sync(0xffffffffu, value, step);
#endif
    return value;
"""
)
def sum_of_lanes_in_double(value: wp.float64) -> wp.float64:
    """`sum_of_lanes` in float64."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 1; step < some; step <<= 1)
        value += __shfl_xor_sync(0xffffffffu, value, step);
#endif
    return value;
"""
)
def sum_of_some(value: float, some: int) -> float:
    """The sum of the values of each so many neighbouring lanes, a power of two, the same for each of these."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __shfl_xor_sync(0xffffffffu, value, step);
#else
    return value;
#endif
"""
)
def across(value: float, step: int) -> float:
    """The value of the lane whose number differs in one bit."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __shfl_xor_sync(0xffffffffu, value, step);
#else
    return value;
#endif
"""
)
def across_in_double(value: wp.float64, step: int) -> wp.float64:
    """`across` in float64."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, value, source);
#else
    return value;
#endif
"""
)
def from_lane(value: float, source: int) -> float:
    """Another lane's value."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, value, source);
#else
    return value;
#endif
"""
)
def int_from_lane(value: int, source: int) -> int:
    """Another lane's whole number."""
    ...


@wp.func_native(
    snippet="""
    for (int k = 0; k < rank; ++k)
        bits &= bits - 1;
#if defined(__CUDA_ARCH__)
    return bits != 0 ? __ffs(bits) - 1 : 32;
#else
    return bits != 0 ? __builtin_ctz(bits) : 32;
#endif
"""
)
def bit_at(bits: int, rank: int) -> int:
    """The place of the bit that is set beside so many lower ones; 32 if there is none."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, value, source);
#else
    return value;
#endif
"""
)
def double_from_lane(value: wp.float64, source: int) -> wp.float64:
    """Another lane's value in float64."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 1; step < some; step <<= 1)
        value = fminf(value, __shfl_xor_sync(0xffffffffu, value, step));
#endif
    return value;
"""
)
def least_of_some(value: float, some: int) -> float:
    """The least value of each so many neighbouring lanes, a power of two, the same for each of these."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    __syncwarp();
#endif
"""
)
def wait_for_lanes():
    """Barrier of the group's lanes: what they wrote before is there for all of them afterwards."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
"""
)
def wait_for_block():
    """The same barrier of all threads of a block, of which each has to come here."""
    ...
