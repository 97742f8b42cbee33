"""Nearest sites of the lines of a bundle, which lie side by side, by a group of lanes that has a line each.

The nearest site moves forward as the place does. So the sites nearest to eight places far apart bound those of the
places between, and eight of these those of runs of eight places, whose few sites are all tried. All lanes look at the
same sites, from the least that one of them may need to the greatest: what they read lies side by side, and is asked for
several sites at a time.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.edt import bundle_loops

wp.set_module_options({"enable_backward": False})

Places = wp.types.vector(length=8, dtype=wp.float32)
# Of eight places the least and the greatest of the lanes' sites, where `least_at` and `greatest_at` find them.
Bounds = wp.types.vector(length=16, dtype=wp.int32)


@wp.func_native(snippet=bundle_loops.winners_of_class())
def nearest_of_class(
    heights: wp.array(dtype=wp.float32),
    base: int,
    stride: int,
    has: wp.array(dtype=wp.int32),
    first: int,
    step: int,
    gaps: bool,
    low: int,
    high: int,
    place: int,
    apart: int,
    weight: float,
    half: float,
) -> Bounds:
    """The nearest of the sites from `low` to `high` that `has`, from `first` on, says are there.

    To eight places, of which the first is `place` and each is `apart` from the one before.
    """
    ...


@wp.func_native(snippet=bundle_loops.least_of_class())
def least_of_class(
    heights: wp.array(dtype=wp.float32),
    base: int,
    stride: int,
    has: wp.array(dtype=wp.int32),
    first: int,
    step: int,
    gaps: bool,
    low: int,
    high: int,
    place: int,
    apart: int,
    weight: float,
    half: float,
) -> Places:
    """The squared distances to what `nearest_of_class` names."""
    ...


@wp.func_native(snippet=bundle_loops.winners_of_others())
def nearest_of_others(
    heights: wp.array(dtype=wp.float32),
    base: int,
    stride: int,
    labels: wp.array(dtype=wp.uint8),
    value: wp.uint8,
    low: int,
    high: int,
    place: int,
    apart: int,
    weight: float,
    half: float,
) -> Bounds:
    """`nearest_of_class` for voxels that have a label, whose heights are where it is; at others these are zero."""
    ...


@wp.func_native(snippet=bundle_loops.least_of_others())
def least_of_others(
    heights: wp.array(dtype=wp.float32),
    base: int,
    stride: int,
    labels: wp.array(dtype=wp.uint8),
    value: wp.uint8,
    low: int,
    high: int,
    place: int,
    apart: int,
    weight: float,
    half: float,
) -> Places:
    """The squared distances to what `nearest_of_others` names."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, bounds[0], place);
#else
    return bounds[place];
#endif
"""
)
def least_at(bounds: Bounds, place: int) -> int:
    """The least site that is nearest to a place of a bundle."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, bounds[1], place);
#else
    return bounds[8 + place];
#endif
"""
)
def greatest_at(bounds: Bounds, place: int) -> int:
    """The greatest site that is nearest to a place of a bundle."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int block = low; block <= high; block += 32) {
        const int mine = block + (threadIdx.x & 31);
        if (__any_sync(0xffffffffu, mine <= high && has.data[first + mine * step] == 0))
            return true;
    }
#else
    for (int site = low; site <= high; ++site)
        if (has.data[first + site * step] == 0)
            return true;
#endif
    return false;
"""
)
def has_gaps(has: wp.array(dtype=wp.int32), first: int, step: int, low: int, high: int) -> bool:
    """True if one of the sites from `low` to `high` is not there, by what `has` says from `first` on."""
    ...


@wp.func_native(
    snippet="""
    float value[8];
    #pragma unroll
    for (int i = 0; i < 8; ++i)
        value[i] = best[i];
    bool usual = scale <= 0.0f && own_base < 0;
#if defined(__CUDA_ARCH__)
    // Numbers that are not below zero are ordered as their bits are.
    int bits[8], least = 0x7fffffff, most = 0;
    #pragma unroll
    for (int i = 0; i < 8; ++i)
        bits[i] = __float_as_int(best[i]);
    #pragma unroll
    for (int i = 0; i < 8; i += 2) {
        least = __vimin3_s32(least, bits[i], bits[i + 1]);
        most = __vimax3_s32(most, bits[i], bits[i + 1]);
    }
    // What `sqrtf` does, without its question for each number whether it is one of those with which this fails.
    if (!usual && least >= 0x0d000000 && most < 0x7f000000) {
        usual = true;
        if (scale > 0.0f) {
            #pragma unroll
            for (int i = 0; i < 8; ++i) {
                float inverse;
                asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(inverse) : "f"(best[i]));
                const float root = __fmul_rn(inverse, best[i]);
                value[i] = scale * __fmaf_rn(__fmaf_rn(-root, root, best[i]), __fmul_rn(inverse, 0.5f), root);
            }
        }
    }
#endif
    if (!usual) {
        #pragma unroll
        for (int i = 0; i < 8; ++i) {
            if (scale > 0.0f)
                value[i] = best[i] < INFINITY ? scale * sqrtf(best[i]) : missing;
            if (own_base >= 0 && best[i] == 0.0f && (wanted >> i & 1))
                value[i] = -own.data[own_base + (x + i) * stride];
        }
    }
    char* to = reinterpret_cast<char*>(out.data + (base + x * stride));
#if defined(__CUDA_ARCH__)
    asm("" : "+l"(to));
#endif
    auto write = [&](int i) {
        float* at = reinterpret_cast<float*>(to + (long long)(4 * i) * stride);
#if defined(__CUDA_ARCH__)
        __stwb(at, value[i]);
#else
        *at = value[i];
#endif
    };
    if (wanted == 255) {
        #pragma unroll
        for (int i = 0; i < 8; ++i)
            write(i);
    } else {
        #pragma unroll
        for (int i = 0; i < 8; ++i)
            if (wanted >> i & 1)
                write(i);
    }
"""
)
def write_places(
    best: Places,
    wanted: int,
    x: int,
    base: int,
    stride: int,
    scale: float,
    missing: float,
    own: wp.array(dtype=wp.float32),
    own_base: int,
    out: wp.array(dtype=wp.float32),
):
    """Write what those of eight places from `x` on that are `wanted`, by bits, get at these squared distances."""
    ...


@wp.func_native(
    snippet="""
    const wp::uint8* nearby = labels.data + (base + x * stride);
#if defined(__CUDA_ARCH__)
    asm("" : "+l"(nearby));
#endif
    const int last = end - 1 - x;
    bool found = false;
    #pragma unroll
    for (int i = 0; i < 16; ++i) {
        const wp::uint8* at = nearby + (long long)wp::min(i, last) * stride;
#if defined(__CUDA_ARCH__)
        found |= __ldg(at) == value;
#else
        found |= *at == value;
#endif
    }
    return found;
"""
)
def is_soon(labels: wp.array(dtype=wp.uint8), base: int, stride: int, x: int, end: int, value: wp.uint8) -> bool:
    """True if one of 16 places from `x` on, before `end`, has a label: all are asked for before one is waited for."""
    ...


@wp.func_native(
    snippet="""
    int found = 0;
    #pragma unroll
    for (int i = 0; i < 8; ++i)
        if (x + i < end && labels.data[base + (x + i) * stride] == value)
            found |= 1 << i;
    return found;
"""
)
def places_with(labels: wp.array(dtype=wp.uint8), base: int, stride: int, x: int, end: int, value: wp.uint8) -> int:
    """One bit for each of eight places from `x` on, before `end`, that has a label."""
    ...
