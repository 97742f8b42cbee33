"""Solid angles of a box's near caps from two of its voxels for each lane, with the largest errors of float32."""

from __future__ import annotations

import warp as wp

from sdm.kernels.winding.near_caps import CAP, FACTOR, FULL, LARGEST_PRODUCT, SEEN, TOOLS, UNIT

wp.set_module_options({"enable_backward": False})

# Numbers of a cap in shared memory, of 32 for each of four groups of lanes.
_ROW, _GROUPS = 16, 4


@wp.func_native(
    snippet=f"""
    {TOOLS}
    const float p0x = p.c[0], p0y = p.c[1], p0z = p.c[2], p1x = q.c[0], p1y = q.c[1], p1z = q.c[2];
    float re0 = 1.0f, im0 = 0.0f, error0 = 0.0f, re1 = 1.0f, im1 = 0.0f, error1 = 0.0f;
    int turns0 = 0, turns1 = 0;
    auto see = [&](float px, float py, float pz, float x0, float y0, float z0, float x1, float y1, float z1, float x2,
                   float y2, float z2, float nx, float ny, float nz, float rounded, float snapped, float& re, float& im,
                   float& error, int& turns) {{
        {SEEN}
        {FACTOR}
    }};
    auto shrunk = [](float& re, float& im) {{
        const float shrink = fabsf(re) + fabsf(im) > {LARGEST_PRODUCT}f ? {1.0 / LARGEST_PRODUCT}f : 1.0f;
        re *= shrink;
        im *= shrink;
    }};
#if defined(__CUDA_ARCH__)
    __shared__ float4 shared[{_GROUPS} * 32 * {_ROW // 4}];
    const int mine = threadIdx.x & 31;
    float4* rows = shared + threadIdx.x / 32 * 32 * {_ROW // 4};
    for (int begin = 0; begin < near; begin += 32) {{
        __syncwarp();
        if (begin + mine < near) {{
            const int place = listed.data[at + begin + mine];
            {CAP}
            rows[mine] = make_float4(x0, y0, z0, rounded);
            rows[32 + mine] = make_float4(x1, y1, z1, snapped);
            rows[64 + mine] = make_float4(x2, y2, z2, nx);
            rows[96 + mine] = make_float4(ny, nz, 0.0f, 0.0f);
        }}
        __syncwarp();
        const int end = min(32, near - begin);
        #pragma unroll 1
        for (int i = 0; i < end; ++i) {{
            const float4 a = rows[i], b = rows[32 + i], c = rows[64 + i];
            const float2 n = *reinterpret_cast<const float2*>(rows + 96 + i);
            see(p0x, p0y, p0z, a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z, c.w, n.x, n.y, a.w, b.w, re0, im0, error0,
                turns0);
            see(p1x, p1y, p1z, a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z, c.w, n.x, n.y, a.w, b.w, re1, im1, error1,
                turns1);
        }}
        shrunk(re0, im0);
        shrunk(re1, im1);
    }}
#else
    for (int i = 0; i < near; ++i) {{
        const int place = listed.data[at + i];
        {CAP}
        see(p0x, p0y, p0z, x0, y0, z0, x1, y1, z1, x2, y2, z2, nx, ny, nz, rounded, snapped, re0, im0, error0, turns0);
        see(p1x, p1y, p1z, x0, y0, z0, x1, y1, z1, x2, y2, z2, nx, ny, nz, rounded, snapped, re1, im1, error1, turns1);
        shrunk(re0, im0);
        shrunk(re1, im1);
    }}
#endif
    const float angle0 = 2.0f * atan2f(im0, re0) + {FULL}f * (float)turns0;
    const float angle1 = 2.0f * atan2f(im1, re1) + {FULL}f * (float)turns1;
    return wp::vec4(angle0, error0 + {4.0 * UNIT}f * fabsf(angle0), angle1, error1 + {4.0 * UNIT}f * fabsf(angle1));
"""
)
def near_pair(
    corners: wp.array(dtype=wp.vec3), near: int, p: wp.vec3, q: wp.vec3, listed: wp.array(dtype=wp.int32), at: int
) -> wp.vec4:
    """The solid angle of the caps listed at a place, seen from p (scaled), its largest error, and both from q.

    The list is the same for all lanes of a group, all of which have to ask. See `near_caps.near_angle`.
    """
    ...
