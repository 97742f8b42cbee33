"""Coalesced stores: records of neighbouring threads, one each, written together.

A record is read by one lane, so its bytes lie together. But if each thread wrote its own, in pieces of sixteen bytes,
a GPU's memory would see each half of its sectors of 32 bytes by itself. So the threads put their records into shared
memory, and then write all of a warp's as one piece. On a CPU a record is written where it belongs.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.lanes import GPU_GROUPS, GPU_LANES

wp.set_module_options({"enable_backward": False})

# Bytes of the largest record, and threads of a block.
LARGEST, THREADS = 96, GPU_GROUPS * GPU_LANES


@wp.func_native(snippet="return (wp::uint64)data.data;")
def floats_at(data: wp.array(dtype=wp.float32)) -> wp.uint64:
    """The address of an array."""
    ...


@wp.func_native(snippet="return (wp::uint64)data.data;")
def doubles_at(data: wp.array(dtype=wp.float64)) -> wp.uint64:
    """The address of an array."""
    ...


@wp.func_native(snippet="return (wp::uint64)data.data;")
def vectors_at(data: wp.array(dtype=wp.vec3)) -> wp.uint64:
    """The address of an array."""
    ...


@wp.func_native(snippet="return (wp::uint64)data.data;")
def pairs_at(data: wp.array(dtype=wp.vec2i)) -> wp.uint64:
    """The address of an array."""
    ...


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    // Each warp has its own part, whatever the size, as other warps may be at another record.
    __shared__ float4 room[{THREADS} * {LARGEST // 16}];
    return (wp::uint64)(reinterpret_cast<char*>(room) + threadIdx.x / 32 * (32 * {LARGEST}) + threadIdx.x % 32 * size);
#else
    return records + (wp::uint64)number * size;
#endif
"""
)
def begin_record(records: wp.uint64, size: int, number: int) -> wp.uint64:
    """Address for a thread's record of `size` bytes, a multiple of 8: the number-th of those at an address.

    Records of different arrays follow each other: each is ended before the next is begun.
    """
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    reinterpret_cast<float4*>(record)[row] = make_float4(x, y, z, w);
#else
    float* v = reinterpret_cast<float*>(record) + 4 * row;
    v[0] = x; v[1] = y; v[2] = z; v[3] = w;
#endif
"""
)
def put4(record: wp.uint64, row: int, x: float, y: float, z: float, w: float):
    """Four floats of a record."""
    ...


@wp.func_native(snippet="reinterpret_cast<double*>(record)[place] = x;")
def put_double(record: wp.uint64, place: int, x: wp.float64):
    """One float64 of a record."""
    ...


@wp.func_native(snippet="reinterpret_cast<wp::vec2i*>(record)[place] = pair;")
def put_pair(record: wp.uint64, place: int, pair: wp.vec2i):
    """Two whole numbers of a record."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    const int lane = threadIdx.x % 32;
    const int there = min(32, total - (number - lane));
    const unsigned mask = 0xffffffffu >> (32 - there);
    __syncwarp(mask);
    const char* from = reinterpret_cast<const char*>(record) - lane * size;
    char* to = reinterpret_cast<char*>(records) + (size_t)(number - lane) * size;
    if (size % 16 == 0)
        for (int i = lane; i < there * size / 16; i += there)
            reinterpret_cast<float4*>(to)[i] = reinterpret_cast<const float4*>(from)[i];
    else
        for (int i = lane; i < there * size / 8; i += there)
            reinterpret_cast<float2*>(to)[i] = reinterpret_cast<const float2*>(from)[i];
    __syncwarp(mask);
#endif
"""
)
def end_record(records: wp.uint64, record: wp.uint64, size: int, number: int, total: int):
    """Write what was put: to be called by all `total` threads of a launch, each for the record of its own number."""
    ...
