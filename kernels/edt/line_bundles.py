"""Nearest sites of the lines of a bundle, which lie side by side, by a group of lanes that has a line each.

The nearest site moves forward as the place does. So the sites nearest to eight places far apart bound those of the
places between, and eight of these those of runs of eight places, whose few sites are all tried. All lanes look at the
same sites, from the least that one of them may need to the greatest: what they read lies side by side, and is asked for
four sites at a time.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

Places = wp.types.vector(length=8, dtype=wp.float32)
# Of eight places the least and the greatest of the lanes' sites, where `least_at` and `greatest_at` find them.
Bounds = wp.types.vector(length=16, dtype=wp.int32)

# Calls `visit(site, height, place)` for the sites from `low` to `high`, with `from` the way to the first place.
_EACH_SITE = """
#if defined(__CUDA_ARCH__)
    const int lanes = 32;
#else
    const int lanes = 1;
#endif
    auto look = [&](bool has_boxes) {
        for (int block = low; block <= high; block += lanes) {
#if defined(__CUDA_ARCH__)
            const int mine = block + (threadIdx.x & 31);
            unsigned sites = __ballot_sync(0xffffffffu, mine <= high && THERE(mine));
#else
            unsigned sites = THERE(block) ? 1 : 0;
#endif
            while (sites) {
                float height[4];
                int site[4];
                #pragma unroll
                for (int k = 0; k < 4; ++k) {
                    site[k] = -1;
                    if (sites) {
#if defined(__CUDA_ARCH__)
                        site[k] = block + __ffs(sites) - 1;
#else
                        site[k] = block;
#endif
                        sites &= sites - 1;
                        height[k] = HEIGHT(site[k]);
                    }
                }
                #pragma unroll
                for (int k = 0; k < 4; ++k) {
                    if (site[k] >= 0) {
                        const float from = wp::float32(place) - wp::float32(site[k]);
                        #pragma unroll
                        for (int i = 0; i < 8; ++i) {
                            float away = from + wp::float32(i * apart);
                            if (has_boxes)
                                away = wp::max(wp::abs(away) - half, 0.0f);
                            const float squared = height[k] + weight * (away * away);
                            VISIT
                        }
                    }
                }
            }
        }
    };
    if (half == 0.0f)
        look(false);
    else
        look(true);
"""
_WINNERS = (
    """
    float best[8];
    int winner[8];
    #pragma unroll
    for (int i = 0; i < 8; ++i) {
        best[i] = INFINITY;
        winner[i] = low;
    }
"""
    + _EACH_SITE.replace(
        "VISIT",
        """
                            if (squared < best[i]) {
                                best[i] = squared;
                                winner[i] = site[k];
                            }
""",
    )
    + """
    wp::vec_t<16, wp::int32> bounds;
    #pragma unroll
    for (int i = 0; i < 8; ++i) {
        int least = winner[i], greatest = winner[i];
#if defined(__CUDA_ARCH__)
#if __CUDA_ARCH__ >= 800
        least = __reduce_min_sync(0xffffffffu, least);
        greatest = __reduce_max_sync(0xffffffffu, greatest);
#else
        for (int step = 16; step > 0; step >>= 1) {
            least = min(least, __shfl_xor_sync(0xffffffffu, least, step));
            greatest = max(greatest, __shfl_xor_sync(0xffffffffu, greatest, step));
        }
#endif
        if ((threadIdx.x & 31) == i) {
            bounds[0] = least;
            bounds[1] = greatest;
        }
#else
        bounds[i] = least;
        bounds[8 + i] = greatest;
#endif
    }
    return bounds;
"""
)
_LEAST = (
    """
    wp::vec_t<8, wp::float32> best;
    #pragma unroll
    for (int i = 0; i < 8; ++i)
        best[i] = INFINITY;
"""
    + _EACH_SITE.replace("VISIT", "best[i] = wp::min(best[i], squared);")
    + """
    return best;
"""
)


def _of_class(snippet: str) -> str:
    there = snippet.replace("THERE(mine)", "has.data[first + mine * step] != 0")
    there = there.replace("THERE(block)", "has.data[first + block * step] != 0")
    return there.replace("HEIGHT(site[k])", "heights.data[base + site[k] * stride]")


def _of_others(snippet: str) -> str:
    there = snippet.replace("THERE(mine)", "true").replace("THERE(block)", "true")
    at = "base + site[k] * stride"
    return there.replace("HEIGHT(site[k])", f"labels.data[{at}] == value ? heights.data[{at}] : 0.0f")


@wp.func_native(snippet=_of_class(_WINNERS))
def nearest_of_class(
    heights: wp.array(dtype=wp.float32),
    base: int,
    stride: int,
    has: wp.array(dtype=wp.int32),
    first: int,
    step: int,
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


@wp.func_native(snippet=_of_class(_LEAST))
def least_of_class(
    heights: wp.array(dtype=wp.float32),
    base: int,
    stride: int,
    has: wp.array(dtype=wp.int32),
    first: int,
    step: int,
    low: int,
    high: int,
    place: int,
    apart: int,
    weight: float,
    half: float,
) -> Places:
    """The squared distances to what `nearest_of_class` names."""
    ...


@wp.func_native(snippet=_of_others(_WINNERS))
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


@wp.func_native(snippet=_of_others(_LEAST))
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
