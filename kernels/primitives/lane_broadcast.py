"""Broadcast among the lanes of a group: four numbers of each, in shared memory.

An exchange between lanes brings one number and takes four cycles; a read of shared memory brings all lanes the same
four numbers, and many such reads may be under way at a time.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.lanes import GPU_GROUPS, GPU_LANES

wp.set_module_options({"enable_backward": False})


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    __shared__ float4 shared[{GPU_GROUPS * GPU_LANES}];
    return (wp::uint64)(shared + threadIdx.x / {GPU_LANES} * {GPU_LANES});
#else
    return 0;
#endif
"""
)
def broadcast_buffer() -> wp.uint64:
    """The address of a group's buffer in shared memory; a CPU, of which a group has one lane, needs none."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    // What was broadcast before is read until here.
    __syncwarp();
    reinterpret_cast<float4*>(buffer)[lane] = make_float4(mine[0], mine[1], mine[2], mine[3]);
    __syncwarp();
#endif
"""
)
def broadcast(buffer: wp.uint64, mine: wp.vec4, lane: int):
    """Broadcast four numbers of each lane; all lanes must come here."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    // Always as many: loads are then far ahead of their use.
    const float4* row = reinterpret_cast<const float4*>(buffer);
    float least = __int_as_float(0x7f800000);
    int nearest = 0;
    #pragma unroll 8
    for (int k = 0; k < 32; ++k) {
        const float4 b = row[k];
        const float x = p[0] - b.x, y = p[1] - b.y, z = p[2] - b.z;
        const float d2 = k < count ? x * x + y * y + z * z : least;
        nearest = d2 < least ? k : nearest;
        least = d2 < least ? d2 : least;
    }
    return wp::vec2(least, (float)nearest);
#else
    const wp::vec3 d = p - wp::vec3(mine[0], mine[1], mine[2]);
    return wp::vec2(wp::dot(d, d), 0.0f);
#endif
"""
)
def nearest_of_broadcast(buffer: wp.uint64, count: int, p: wp.vec3, mine: wp.vec4) -> wp.vec2:
    """The least squared distance from p to the middle of one of the first `count` balls broadcast, and its number."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    const float4* row = reinterpret_cast<const float4*>(buffer);
    unsigned found = 0;
    #pragma unroll 8
    for (int k = 0; k < 32; ++k) {
        const float4 b = row[k];
        const float x = p[0] - b.x, y = p[1] - b.y, z = p[2] - b.z, reach = bound + b.w;
        // Not the opposite test: what is no number is within.
        found |= !(x * x + y * y + z * z > reach * reach) ? 1u << k : 0u;
    }
    return count < 32 ? found & ((1u << count) - 1u) : found;
#else
    const wp::vec3 d = p - wp::vec3(mine[0], mine[1], mine[2]);
    const float reach = bound + mine[3];
    return !(wp::dot(d, d) > reach * reach) ? 1u : 0u;
#endif
"""
)
def broadcast_within(buffer: wp.uint64, count: int, p: wp.vec3, bound: float, mine: wp.vec4) -> wp.uint32:
    """One bit for each of the first `count` balls broadcast that come within `bound` of p."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    __syncwarp();
    reinterpret_cast<int4*>(buffer)[lane] = make_int4(mine[0], mine[1], mine[2], mine[3]);
    __syncwarp();
#endif
"""
)
def broadcast_ints(buffer: wp.uint64, mine: wp.vec4i, lane: int):
    """`broadcast` of whole numbers."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    const int4* row = reinterpret_cast<const int4*>(buffer);
    unsigned found = 0;
    #pragma unroll 8
    for (int k = 0; k < 32; ++k) {
        const int4 b = row[k];
        found |= (q[0] >= b.x) & (q[1] >= b.y) & (q[0] <= b.z) & (q[1] <= b.w) ? 1u << k : 0u;
    }
    return count < 32 ? found & ((1u << count) - 1u) : found;
#else
    return ((q[0] >= mine[0]) & (q[1] >= mine[1]) & (q[0] <= mine[2]) & (q[1] <= mine[3])) ? 1u : 0u;
#endif
"""
)
def broadcast_around(buffer: wp.uint64, count: int, q: wp.vec2i, mine: wp.vec4i) -> wp.uint32:
    """One bit for each of the first `count` boxes (least, greatest) broadcast that hold q."""
    ...
