"""CUDA and C++ text of `line_bundles`: the loops over the sites that a group of lanes looks at together."""

from __future__ import annotations

# Sites side by side of which one is found to be the nearest, as that takes more than to measure them: for places far
# apart, and for nearer ones.
FAR, NEAR = 4, 2

# VISIT for each site from `low` to `high` that is there: the way from it to the first place is `from`.
_WITH_GAPS = """
#if defined(__CUDA_ARCH__)
    const int lanes = 32;
#else
    const int lanes = 1;
#endif
    for (int block = low; block <= high; block += lanes) {
#if defined(__CUDA_ARCH__)
        const int mine = block + (threadIdx.x & 31);
        unsigned sites = __ballot_sync(0xffffffffu, mine <= high && has.data[first + mine * step] != 0);
#else
        unsigned sites = has.data[first + block * step] != 0 ? 1 : 0;
#endif
        while (sites) {
#if defined(__CUDA_ARCH__)
            const int site = block + __ffs(sites) - 1;
#else
            const int site = block;
#endif
            sites &= sites - 1;
            const float height = heights.data[base + site * stride];
            const float from = wp::float32(place - site);
            #pragma unroll
            for (int i = 0; i < 8; ++i) {
                float away = from + wp::float32(i * apart);
                if (half != 0.0f)
                    away = wp::max(wp::abs(away) - half, 0.0f);
                const float squared = height + weight * (away * away);
                VISIT
            }
        }
    }
"""
# Heights of `some` sites from `site` on. What is beyond the last one is out of reach.
_HEIGHTS = """
            NEARBY
            float height[4];
            #pragma unroll
            for (int k = 0; k < 4; ++k) {
                height[k] = INFINITY;
                if (k < some && site + k <= high)
                    height[k] = HEIGHT(site + k);
            }
"""
# Arrays that are read are not written by the same kernel.
_READ = """
    auto read = [](auto* from) {
#if defined(__CUDA_ARCH__)
        return __ldg(from);
#else
        return *from;
#endif
    };
"""
# Costs are not below zero, so that the bits of the least are the least bits, of which a GPU compares three at a time.
_LEAST_OF = """
    auto least_of = [](float a, float b, float c) {
#if defined(__CUDA_ARCH__)
        return __int_as_float(__vimin3_s32(__float_as_int(a), __float_as_int(b), __float_as_int(c)));
#else
        return wp::min(a, wp::min(b, c));
#endif
    };
"""
# The nearest of the sites from `low` to `high`, or of each `some` the first one.
_WINNERS_WITHOUT_GAPS = (
    _READ
    + _LEAST_OF
    + """
    auto look = [&](bool has_boxes) {
        for (int site = low; site <= high; site += some) {
"""
    + _HEIGHTS
    + """
            const float from = wp::float32(place - site);
            #pragma unroll
            for (int i = 0; i < 8; ++i) {
                float squared[4] = {INFINITY, INFINITY, INFINITY, INFINITY};
                #pragma unroll
                for (int k = 0; k < 4; ++k) {
                    if (k < some) {
                        float away = from + wp::float32(i * apart - k);
                        if (has_boxes)
                            away = wp::max(wp::abs(away) - half, 0.0f);
                        squared[k] = height[k] + weight * (away * away);
                    }
                }
                float least = some > 1 ? least_of(squared[0], squared[1], squared[2]) : squared[0];
                if (some > 3)
                    least = least_of(least, squared[3], squared[3]);
                if (least < best[i]) {
                    best[i] = least;
                    winner[i] = site;
                }
            }
        }
    };
    if (half == 0.0f)
        look(false);
    else
        look(true);
"""
)
_WINNERS = """
    float best[8];
    int winner[8];
    #pragma unroll
    for (int i = 0; i < 8; ++i) {
        best[i] = INFINITY;
        winner[i] = low;
    }
    LOOK
    wp::vec_t<16, wp::int32> bounds;
    #pragma unroll
    for (int i = 0; i < 8; ++i) {
        int least = winner[i], greatest = wp::min(winner[i] + some - 1, high);
#if defined(__CUDA_ARCH__)
#if __CUDA_ARCH__ >= 800
        least = __reduce_min_sync(0xffffffffu, least);
        greatest = __reduce_max_sync(0xffffffffu, greatest);
#else
        for (int lanes = 16; lanes > 0; lanes >>= 1) {
            least = min(least, __shfl_xor_sync(0xffffffffu, least, lanes));
            greatest = max(greatest, __shfl_xor_sync(0xffffffffu, greatest, lanes));
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
# Squared distances to eight places side by side, which share what they are away from `some` sites side by side.
_LEAST_WITHOUT_GAPS = (
    _READ
    + _LEAST_OF
    + """
    auto look = [&](bool has_boxes) {
        for (int site = low; site <= high; site += some) {
"""
    + _HEIGHTS
    + """
#if defined(__CUDA_ARCH__)
            // Asked for before any of them is waited for.
            asm volatile("" : "+f"(height[0]), "+f"(height[1]), "+f"(height[2]), "+f"(height[3]));
#endif
            const float from = wp::float32(place - site);
            float square[7 + some];
            #pragma unroll
            for (int j = 0; j < 7 + some; ++j) {
                float away = from + wp::float32(j - some + 1);
                if (has_boxes)
                    away = wp::max(wp::abs(away) - half, 0.0f);
                square[j] = away * away;
            }
            #pragma unroll
            for (int k = 0; k < some; k += 2) {
                if (k == 0 || site + k <= high) {
                    #pragma unroll
                    for (int i = 0; i < 8; ++i) {
                        const float one = height[k] + weight * square[i + some - 1 - k];
                        const float other = height[k + 1] + weight * square[i + some - 2 - k];
                        best[i] = least_of(best[i], one, other);
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
)
_LEAST = """
    wp::vec_t<8, wp::float32> best;
    #pragma unroll
    for (int i = 0; i < 8; ++i)
        best[i] = INFINITY;
    LOOK
    return best;
"""
# Addresses that a GPU's compiler takes as they are, so that it adds one number to each.
_CLASS_NEARBY = """
            const char* nearby = reinterpret_cast<const char*>(heights.data + (base + site * stride));
#if defined(__CUDA_ARCH__)
            asm("" : "+l"(nearby));
#endif
"""
_OTHERS_NEARBY = (
    _CLASS_NEARBY
    + """
            const wp::uint8* labels_nearby = labels.data + (base + site * stride);
#if defined(__CUDA_ARCH__)
            asm("" : "+l"(labels_nearby));
#endif
"""
)
_NEARER = "if (squared < best[i]) { best[i] = squared; winner[i] = site; }"
_OF_CLASS = "read(reinterpret_cast<const float*>(nearby + (long long)(4 * k) * stride))"
_OF_OTHERS = f"read(labels_nearby + (long long)k * stride) == value ? {_OF_CLASS} : 0.0f"


def winners_of_class() -> str:
    """The body of `line_bundles.nearest_of_class`."""
    looks = "if (gaps) {" + _WITH_GAPS.replace("VISIT", _NEARER) + "} else {" + _WINNERS_WITHOUT_GAPS + "}"
    some = f"const int some = gaps ? 1 : apart > 8 ? {FAR} : {NEAR};"
    return some + _WINNERS.replace("LOOK", looks).replace("HEIGHT(site + k)", _OF_CLASS).replace(
        "NEARBY", _CLASS_NEARBY
    )


def least_of_class() -> str:
    """The body of `line_bundles.least_of_class`."""
    nearer = "best[i] = wp::min(best[i], squared);"
    looks = "if (gaps) {" + _WITH_GAPS.replace("VISIT", nearer) + "} else {" + _LEAST_WITHOUT_GAPS + "}"
    return "constexpr int some = 4;" + _LEAST.replace("LOOK", looks).replace("HEIGHT(site + k)", _OF_CLASS).replace(
        "NEARBY", _CLASS_NEARBY
    )


def winners_of_others() -> str:
    """The body of `line_bundles.nearest_of_others`."""
    some = f"const int some = apart > 8 ? {FAR} : {NEAR};"
    return some + _WINNERS.replace("LOOK", _WINNERS_WITHOUT_GAPS).replace("HEIGHT(site + k)", _OF_OTHERS).replace(
        "NEARBY", _OTHERS_NEARBY
    )


def least_of_others() -> str:
    """The body of `line_bundles.least_of_others`."""
    look = _LEAST_WITHOUT_GAPS.replace("HEIGHT(site + k)", _OF_OTHERS).replace("NEARBY", _OTHERS_NEARBY)
    return "constexpr int some = 4;" + _LEAST.replace("LOOK", look)
