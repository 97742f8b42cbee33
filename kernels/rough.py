"""Roots to within two roundings: fewer instructions on a GPU, for tests that have room for it."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


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
