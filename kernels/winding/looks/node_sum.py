"""Solid angle of the caps under listed nodes from single points: what is near a box, but far for each of its voxels.

With u the way from a voxel to a node's centre, D = |u| and Z = u/D, the caps under the node fill (`cap_field`, with a
box of no size)

    (M1.Z - 3 M2 Z Z/D + 7.5 M3 Z Z Z/D^2 - 17.5 M4 Z Z Z Z/D^3) / D^2,

and what that leaves out is at most

    area mean of |y|^4 / D^6 (5 - 4 rho) / (1 - rho)^2 <= area r^2 sigma^2 (5 - 4 rho) / (D^4 (D - r)^2),   rho = r/D,

as the mean of |y|^4 is at most r^2 sigma^2. Rounding is that of a field at its centre (`cap_tree`).
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.winding.cap_tree import MOMENTS_SIZE
from sdm.kernels.winding.near_caps import UNIT

wp.set_module_options({"enable_backward": False})

# The rounding of a sum of terms in two numbers, and of those of all lanes, in proportion to the terms' sizes.
SUMMED = 16.0 * UNIT


# Nodes that all lanes of a group read together, and rows of four numbers between those in shared memory.
_TILE, _STEP = 16, 9


@wp.func_native(
    snippet=f"""
    const float px = p.c[0], py = p.c[1], pz = p.c[2];
    float sum = 0.0f, rest = 0.0f;
#if defined(__CUDA_ARCH__)
    typedef float4 Four;
    auto inverse_root = [](float x) {{ float y; asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x)); return y; }};
#else
    struct Four {{ float x, y, z, w; }};
    auto inverse_root = [](float x) {{ return 1.0f / sqrtf(x); }};
#endif
    auto add = [&](const Four* row) {{
        const Four r0 = row[0], r1 = row[1], r2 = row[2], r3 = row[3], r4 = row[4], r5 = row[5], r6 = row[6];
        const Four r7 = row[7];
        const float ux = r0.x - px, uy = r0.y - py, uz = r0.z - pz;
        const float inverse = inverse_root(ux * ux + uy * uy + uz * uz), square = inverse * inverse;
        const float x = ux * inverse, y = uy * inverse, z = uz * inverse, xx = x * x, yy = y * y, zz = z * z;
        const float d = r1.w * x + r2.x * y + r2.y * z;
        const float q = r2.z * (xx - zz) + r3.y * (yy - zz) + 2.0f * (r2.w * x * y + z * (r3.x * x + r3.z * y));
        // What has no trace is told without powers of z alone; the fourth order as `fourth_moment.quartic_at` has it.
        const float c = x * (r3.w * (xx - 3.0f * zz) + 3.0f * r4.z * (yy - zz))
            + y * (r5.x * (yy - 3.0f * zz) + 3.0f * r4.x * (xx - zz))
            + z * (r4.y * (3.0f * xx - zz) + r5.y * (3.0f * yy - zz) + 6.0f * r4.w * x * y);
        const float even = r5.z * (xx * (xx - 6.0f * zz) + zz * zz) + r7.y * (yy * (yy - 6.0f * zz) + zz * zz)
            + r6.y * (6.0f * (xx * yy - (xx + yy) * zz) + 2.0f * zz * zz);
        const float odd = x * y * (r5.w * (xx - 3.0f * zz) + r6.w * (yy - 3.0f * zz))
            + x * z * (r6.x * (xx - zz) + r7.x * (3.0f * yy - zz))
            + y * z * (r6.z * (3.0f * xx - zz) + r7.z * (yy - zz));
        const float far = 7.5f * c - 17.5f * inverse * (even + 4.0f * odd);
        const float angle = square * (d + inverse * (inverse * far - 3.0f * q));
        const float next = sum + angle, added = next - sum;
        rest += (sum - (next - added)) + (angle - added);
        sum = next;
    }};
    const Four* from = reinterpret_cast<const Four*>(moments.data) + {MOMENTS_SIZE // 4} * (size_t)base;
#if defined(__CUDA_ARCH__)
    // All lanes read nodes together, some turns ahead of what they add: one by one each would wait for memory.
    const int here = threadIdx.x & 31;
    Four* rows = reinterpret_cast<Four*>(stack.data);
    Four ahead[{_TILE} / 4];
    auto read = [&](int begin) {{
        #pragma unroll
        for (int k = 0; k < {_TILE} / 4; ++k) {{
            const int i = begin + 4 * k + here / 8;
            if (i < count) ahead[k] = __ldg(from + 8 * stack.data[at + i] + here % 8);
        }}
    }};
    read(0);
    for (int begin = 0; begin < count; begin += {_TILE}) {{
        __syncwarp();
        #pragma unroll
        for (int k = 0; k < {_TILE} / 4; ++k)
            rows[{_STEP} * (4 * k + here / 8) + here % 8] = ahead[k];
        __syncwarp();
        read(begin + {_TILE});
        const int end = min({_TILE}, count - begin);
        #pragma unroll 1
        for (int i = lane; i < end; i += lanes)
            add(rows + {_STEP} * i);
    }}
    __syncwarp();
#else
    for (int i = lane; i < count; i += lanes)
        add(from + 8 * stack.data[at + i]);
#endif
    return sum + rest;
"""
)
def node_sum(
    moments: wp.array(dtype=wp.float32),
    base: int,
    stack: wp.array(dtype=wp.int32),
    at: int,
    count: int,
    p: wp.vec3,
    lane: int,
    lanes: int,
) -> float:
    """A lane's part of the solid angle of the caps under the nodes that are listed at a place, seen from p (scaled).

    All lanes of a group have to ask, of which so many neighbours share a point (`lanes`, a power of two). Nodes are
    read by all of them to the stack's first places.
    """
    ...
