"""Roots and fused products in fewer instructions on a GPU."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# Native text that defines FUSED(a, b, c), a * b + c. On a GPU it is one operation with one rounding, which a compiler
# makes of a product and a sum by itself only where what stands around them lets it.
FUSED = """
#if defined(__CUDA_ARCH__)
#define FUSED(a, b, c) __fmaf_rn(a, b, c)
#else
#define FUSED(a, b, c) ((a) * (b) + (c))
#endif
"""


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    float root;
    asm("sqrt.approx.f32 %0, %1;" : "=f"(root) : "f"(x));
    return root;
#else
    return sqrtf(x);
#endif
"""
)
def about_root(x: float) -> float:
    """The square root to within two roundings."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return rsqrt(x);
#else
    return 1.0 / sqrt(x);
#endif
"""
)
def inverse_root(x: wp.float64) -> wp.float64:
    """1 / sqrt(x) to within two float64 roundings, for x > 0; a root and a quotient are three times as long."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return rsqrtf(x);
#else
    return 1.0f / sqrtf(x);
#endif
"""
)
def about_inverse_root(x: float) -> float:
    """1 / sqrt(x) to within two roundings, for x > 0."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __fdividef(x, y);
#else
    return x / y;
#endif
"""
)
def about_quotient(x: float, y: float) -> float:
    """x / y to within two roundings, for |y| from 2^-126 to 2^126."""
    ...
