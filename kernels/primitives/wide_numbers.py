"""Arithmetic on eight numbers at once on a CPU, which has registers for as many, and on one in each lane of a GPU;
and on sixteen, where a CPU has registers for these.
"""

from __future__ import annotations

# Native text that defines numbers T, masks M, how WIDE they are, and what is done with them. A CPU makes products and
# sums one operation, with one rounding, as a GPU does: for sums whose bits nobody wants again.
NUMBERS = """
#if defined(__CUDA_ARCH__)
    typedef float T;
    typedef bool M;
    constexpr int WIDE = 1;
    auto root = [](T x) { T r; asm("sqrt.approx.f32 %0, %1;" : "=f"(r) : "f"(x)); return r; };
    auto over = [](T x, T y) { return __fdividef(x, y); };
    auto where = [](M m, T x, T y) { return m ? x : y; };
    auto size_of = [](T x) { return fabsf(x); };
    auto all = [](float x) { return x; };
    auto put = [](T& x, int k, float y) { x = y; };
    auto get = [](T x, int k) { return x; };
    auto has = [](M m, int k) { return m; };
    auto any = [](M m) { return m; };
#else
    #pragma clang fp contract(fast)
    constexpr int WIDE = 8;
    typedef unsigned char Mask;
    typedef float T __attribute__((vector_size(4 * WIDE)));
    typedef int M __attribute__((vector_size(4 * WIDE)));
    typedef unsigned U __attribute__((vector_size(4 * WIDE)));
    auto root = [](T x) { for (int k = 0; k < WIDE; ++k) x[k] = __builtin_sqrtf(x[k]); return x; };
    auto over = [](T x, T y) { return x / y; };
    auto where = [](M m, T x, T y) { return (T)((m & (M)x) | (~m & (M)y)); };
    auto size_of = [](T x) { return (T)((M)x & 0x7fffffff); };
    auto all = [](float x) { T all_of_it; for (int k = 0; k < WIDE; ++k) all_of_it[k] = x; return all_of_it; };
    auto put = [](T& x, int k, float y) { x[k] = y; };
    auto get = [](T x, int k) { return x[k]; };
    auto has = [](M m, int k) { return m[k] != 0; };
    typedef bool Bits __attribute__((ext_vector_type(WIDE)));
    auto bits_of = [](M m) { return (int)__builtin_bit_cast(Mask, __builtin_convertvector(m, Bits)); };
    auto any = [&](M m) { return bits_of(m) != 0; };
#endif
    auto least = [&](T x, T y) { return where(x < y, x, y); };
    auto most_of = [&](T x, T y) { return where(x < y, y, x); };
    const T none = all(0.0f), one = all(1.0f), unknown = all(INFINITY);
"""

# The same with sixteen numbers where a CPU has registers of 512 bits, else eight; nothing on a GPU. What they are read
# from has room for sixteen: of numbers of SIXTEEN places those of turn i begin at WIDE * i. Roots, and reciprocals by
# `per`, are then one step of Newton's from 14 bits, which is within 1.2 roundings; `about` is those 14 bits, for what
# only scales, and for bounds with room for it.
SIXTEEN = 16
WIDEST_NUMBERS = NUMBERS.replace(
    """constexpr int WIDE = 8;
    typedef unsigned char Mask;""",
    """
#if defined(__AVX512F__)
    constexpr int WIDE = 16;
    typedef unsigned short Mask;
#else
    constexpr int WIDE = 8;
    typedef unsigned char Mask;
#endif
""",
).replace(
    "auto root = [](T x) { for (int k = 0; k < WIDE; ++k) x[k] = __builtin_sqrtf(x[k]); return x; };",
    """
#if defined(__AVX512F__)
    auto about = [](T x) { return (T)__builtin_ia32_rcp14ps512_mask(x, x, (unsigned short)-1); };
    auto root = [](T x) {
        const T some = x + 1.0e-37f, y = (T)__builtin_ia32_rsqrt14ps512_mask(some, some, (unsigned short)-1), r = x * y;
        return r + (0.5f * y) * (x - r * r);
    };
    auto per = [&](T x) { const T y = about(x); return y + y * (1.0f - x * y); };
#else
    auto root = [](T x) { for (int k = 0; k < WIDE; ++k) x[k] = __builtin_sqrtf(x[k]); return x; };
    auto about = [](T x) { return 1.0f / x; };
    auto per = [](T x) { return 1.0f / x; };
#endif
""",
)

# The arguments of complex numbers on a CPU, by the signs of both parts, and their largest error: a polynomial that is
# right within 2.5e-7, the rest is rounding.
OFF_ANGLE = 2.0e-6
ANGLE_OF = """
    auto angle_of = [&](T x, T y) {
        const T sx = size_of(x), sy = size_of(y), part = least(sx, sy) / most_of(sx, sy), two = part * part;
        T rest = 0.006811743f * two - 0.033604077f;
        rest = rest * two + 0.079623521f;
        rest = rest * two - 0.13233335f;
        rest = rest * two + 0.19807814f;
        rest = rest * two - 0.33317368f;
        T angle = part * (rest * two + 0.99999611f);
        angle = where(sy > sx, 1.57079633f - angle, angle);
        angle = where((M)x < 0, 3.14159265f - angle, angle);
        return (T)((M)angle | ((M)y & (int)0x80000000));
    };
"""
