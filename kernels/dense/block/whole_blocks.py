"""Voxels of blocks of 8^3 that lie within the slab as a whole, on a GPU: read and written without asking where each is.

Most blocks are such, and of few features, so that a seventh of a block's instructions would ask of every voxel whether
it is there, which place it has and whether it was found. What is found here has the same bits. A block in which one
voxel needs more than that is written anew by `voxels.write_voxels`.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.culling.witness_bound import LARGEST_SQUARE
from sdm.kernels.dense.block.shared_layout import MIN_VALUES

wp.set_module_options({"enable_backward": False})

# The least number whose root is a few products, as a compiler itself writes it: 2^-101.
_LEAST_SQUARE = 3.944304526105059e-31


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return lanes == 32 && bits == 3 && nz % 4 == 0 && i + 8 <= nx && j + 8 <= ny && k + 8 <= nz;
#else
    return false;
#endif
"""
)
def is_whole(i: int, j: int, k: int, nx: int, ny: int, nz: int, bits: int, lanes: int) -> bool:
    """True if a block that begins at voxel (i,j,k) of a slab's (nx,ny,nz) is read and written by these functions."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    // A row along k is 32 bytes, and each lane has two of 64.
    const float* row = values.data + (index + ((lane >> 3) * ny + (lane & 7)) * nz);
    asm volatile("prefetch.global.L2 [%0];" :: "l"(row));
    asm volatile("prefetch.global.L2 [%0];" :: "l"(row + 4 * ny * nz));
#endif
"""
)
def fetch_whole(values: wp.array(dtype=wp.float32), index: int, ny: int, nz: int, lane: int):
    """`voxels.fetch_windings` of such a block, whose first voxel has this index."""
    ...


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    const int l = lane;
    const int i = (l >> 3 & 2) | (l >> 1 & 1), j = (l >> 2 & 2) | (l & 1), k = l >> 1 & 2;
    const float* value = reinterpret_cast<const float*>(scratch) + {MIN_VALUES} + 2 * l;
    const int first = index + (i * ny + j) * nz + k;
    const float* from = values.data + first;
    float* to = reinterpret_cast<float*>(address) + first;
    const float floor2 = __fmul_rn(floor, floor);
    // No distance overflows if that of the largest square does not.
    bool fine = unscale * 1.0e18f < INFINITY;
    // Winding numbers first, which a distance may be written over; and nothing is written before all of it is known to
    // be fine.
    float2 two[8];
    #pragma unroll
    for (int octant = 0; octant < 8; ++octant) {{
        const int away = (octant & 4 ? 4 * ny * nz : 0) + (octant & 2 ? 4 * nz : 0) + (octant & 1 ? 4 : 0);
        two[octant] = *reinterpret_cast<const float2*>(from + away);
    }}
    #pragma unroll
    for (int octant = 0; octant < 8; ++octant) {{
        const float2 least = *reinterpret_cast<const float2*>(value + 64 * octant);
        const float square[2] = {{__fadd_rn(floor2, least.x), __fadd_rn(floor2, least.y)}};
        const float turns[2] = {{two[octant].x, two[octant].y}};
        float distance[2];
        #pragma unroll
        for (int v = 0; v < 2; ++v) {{
            const float x = square[v];
            fine &= (x >= {_LEAST_SQUARE}f) & (x < {LARGEST_SQUARE}f) & !(fabsf(turns[v] - 0.5f) < 0.25f);
            float y;
            asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
            const float s = __fmul_rn(x, y), h = __fmul_rn(0.5f, y);
            const float d = __fmul_rn(unscale, __fmaf_rn(__fmaf_rn(-s, s, x), h, s));
            distance[v] = turns[v] > 0.5f ? -d : d;
        }}
        two[octant] = make_float2(distance[0], distance[1]);
    }}
    if (!__all_sync(0xffffffffu, fine)) return false;
    #pragma unroll
    for (int octant = 0; octant < 8; ++octant) {{
        const int away = (octant & 4 ? 4 * ny * nz : 0) + (octant & 2 ? 4 * nz : 0) + (octant & 1 ? 4 : 0);
        *reinterpret_cast<float2*>(to + away) = two[octant];
    }}
    return true;
#else
    return false;
#endif
"""
)
def write_whole(
    scratch: wp.uint64,
    values: wp.array(dtype=wp.float32),
    address: wp.uint64,
    index: int,
    ny: int,
    nz: int,
    unscale: float,
    floor: float,
    lane: int,
) -> bool:
    """Write the distances of such a block; nothing, and false, if one is missed, next to zero, or unclear inside."""
    ...
