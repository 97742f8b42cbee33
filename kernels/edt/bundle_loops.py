"""CUDA and C++ text of `line_bundles`: the loops over the sites that a group of lanes looks at together."""

from __future__ import annotations

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
# Heights of four sites from `site` on. What is beyond the last one is out of reach.
_ASK = """
    float height[4];
    auto ask = [&](int site, float* height) {
        NEARBY
        #pragma unroll
        for (int k = 0; k < 4; ++k) {
            height[k] = INFINITY;
            if (site + k <= high)
                height[k] = HEIGHT(k);
        }
    };
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
# Of each four sites from `low` to `high` the first one, where one of them is nearest: to tell them apart takes longer
# than to look at all later.
_WINNERS_WITHOUT_GAPS = """
    auto look = [&](bool has_boxes) {
        FIRST
        for (int site = low; site <= high; site += 4) {
            NEXT
            const float from = wp::float32(place - site);
            #pragma unroll
            for (int i = 0; i < 8; ++i) {
                float squared[4];
                #pragma unroll
                for (int k = 0; k < 4; ++k) {
                    float away = from + wp::float32(i * apart - k);
                    if (has_boxes)
                        away = wp::max(wp::abs(away) - half, 0.0f);
                    squared[k] = height[k] + weight * (away * away);
                }
                const float least = wp::min(least_of(squared[0], squared[1], squared[2]), squared[3]);
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
# Squared distances to eight places side by side, which share what they are away from four sites side by side.
_LEAST_WITHOUT_GAPS = """
    auto look = [&](bool has_boxes) {
        FIRST
        for (int site = low; site <= high; site += 4) {
            NEXT
            const float from = wp::float32(place - site);
            float square[11];
            #pragma unroll
            for (int j = 0; j < 11; ++j) {
                float away = from + wp::float32(j - 3);
                if (has_boxes)
                    away = wp::max(wp::abs(away) - half, 0.0f);
                square[j] = away * away;
            }
            #pragma unroll
            for (int k = 0; k < 4; k += 2) {
                if (k == 0 || site + k <= high) {
                    #pragma unroll
                    for (int i = 0; i < 8; ++i) {
                        const float one = height[k] + weight * square[i + 3 - k];
                        const float other = height[k + 1] + weight * square[i + 2 - k];
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
# Both are asked for at once.
_OF_OTHERS = f"wanted(read(labels_nearby + (long long)k * stride), {_OF_CLASS})"
_WANTED = "auto wanted = [&](wp::uint8 label, float height) { return label == value ? height : 0.0f; };"
# Loads of others wait for labels, too, and are asked for four sites ahead. A class's own gain nothing by that.
_AT_ONCE = {"FIRST": "", "NEXT": "ask(site, height);"}
_AHEAD = {
    "FIRST": "float ahead[4]; ask(low, ahead);",
    "NEXT": "for (int k = 0; k < 4; ++k) height[k] = ahead[k]; ask(site + 4, ahead);",
}


def winners_of_class() -> str:
    """The body of `line_bundles.nearest_of_class`."""
    looks = "if (gaps) {" + _WITH_GAPS.replace("VISIT", _NEARER) + "} else {" + _of_class(_WINNERS_WITHOUT_GAPS) + "}"
    return "const int some = gaps ? 1 : 4;" + _WINNERS.replace("LOOK", looks)


def least_of_class() -> str:
    """The body of `line_bundles.least_of_class`."""
    nearer = "best[i] = wp::min(best[i], squared);"
    looks = "if (gaps) {" + _WITH_GAPS.replace("VISIT", nearer) + "} else {" + _of_class(_LEAST_WITHOUT_GAPS) + "}"
    return _LEAST.replace("LOOK", looks)


def winners_of_others() -> str:
    """The body of `line_bundles.nearest_of_others`."""
    return "const int some = 4;" + _WINNERS.replace("LOOK", _of_others(_WINNERS_WITHOUT_GAPS))


def least_of_others() -> str:
    """The body of `line_bundles.least_of_others`."""
    return _LEAST.replace("LOOK", _of_others(_LEAST_WITHOUT_GAPS))


def _of_class(look: str) -> str:
    return _filled(_READ + _LEAST_OF + _ASK + look, _CLASS_NEARBY, _OF_CLASS, _AT_ONCE)


def _of_others(look: str) -> str:
    return _filled(_WANTED + _READ + _LEAST_OF + _ASK + look, _OTHERS_NEARBY, _OF_OTHERS, _AHEAD)


def _filled(look: str, nearby: str, height: str, order: dict[str, str]) -> str:
    for name, text in (order | {"NEARBY": nearby, "HEIGHT(k)": height}).items():
        look = look.replace(name, text)
    return look
