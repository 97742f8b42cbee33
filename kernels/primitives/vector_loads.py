"""Vector loads and stores: four numbers of an array in one access, for which a GPU takes as long as for one."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    float4 v = __ldg(reinterpret_cast<const float4*>(data.data) + index);
    return wp::vec4(v.x, v.y, v.z, v.w);
#else
    const float* v = data.data + 4 * index;
    return wp::vec4(v[0], v[1], v[2], v[3]);
#endif
"""
)
def load4(data: wp.array(dtype=wp.float32), index: int) -> wp.vec4:
    """Four floats at 4 * index in one 16-byte access; the array must not be written meanwhile."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    float4 v = __ldg(reinterpret_cast<const float4*>(data.data) + index);
    return wp::vec4(v.x, v.y, v.z, v.w);
#else
    const float* v = reinterpret_cast<const float*>(data.data) + 4 * index;
    return wp::vec4(v[0], v[1], v[2], v[3]);
#endif
"""
)
def load4_of_vectors(data: wp.array(dtype=wp.vec3), index: int) -> wp.vec4:
    """`load4` from an array of three-vectors that lie one behind the other."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    double2 v = __ldg(reinterpret_cast<const double2*>(data.data) + index);
    return wp::vec2d(v.x, v.y);
#else
    const double* v = data.data + 2 * index;
    return wp::vec2d(v[0], v[1]);
#endif
"""
)
def load2(data: wp.array(dtype=wp.float64), index: int) -> wp.vec2d:
    """Two float64 at 2 * index in one 16-byte access; the array must not be written meanwhile."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    int4 v = __ldg(reinterpret_cast<const int4*>(data.data) + index);
    return wp::vec4i(v.x, v.y, v.z, v.w);
#else
    const int* v = data.data + 4 * index;
    return wp::vec4i(v[0], v[1], v[2], v[3]);
#endif
"""
)
def load_row(data: wp.array2d(dtype=wp.int32), index: int) -> wp.vec4i:
    """Row `index` of whole numbers (N,4) that lie one behind the other; they must not be written meanwhile."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    float4 v = reinterpret_cast<const float4*>(data.data)[index];
    return wp::vec4(v.x, v.y, v.z, v.w);
#else
    typedef float Row __attribute__((vector_size(16), aligned(4), may_alias));
    // Volatile, as a compiler would read it in pieces, or some of it twice: another thread may write meanwhile.
    const Row v = *reinterpret_cast<const volatile Row*>(data.data + 4 * (size_t)index);
    return wp::vec4(v[0], v[1], v[2], v[3]);
#endif
"""
)
def read4(data: wp.array(dtype=wp.float32), index: int) -> wp.vec4:
    """Four floats at 4 * index in one access, of an array that this kernel writes too.

    Where another thread writes the row by `write4`, it is the old or the new one, whole.
    """
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    reinterpret_cast<float4*>(data.data)[index] = make_float4(x, y, z, w);
#else
    typedef float Row __attribute__((vector_size(16), aligned(4), may_alias));
    *reinterpret_cast<volatile Row*>(data.data + 4 * (size_t)index) = Row{x, y, z, w};
#endif
"""
)
def write4(data: wp.array(dtype=wp.float32), index: int, x: float, y: float, z: float, w: float):
    """Four floats to 4 * index in one access."""
    ...
