"""A group of lanes that works on one item: the 32 threads of a warp on a GPU, one thread on a CPU.

Kernels written with these few functions run the same algorithm on both. Warp's own atomics are plain additions on a
CPU, where `launch` runs a kernel on several threads, so those that are needed are here as well.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

GPU_LANES = 32
# A multiprocessor holds so many blocks of 128 threads at a time; the compiler shares out registers by it.
GPU_BLOCKS = 4
# Multiprocessors of an H100, and groups of lanes in a block.
GPU_MULTIPROCESSORS, GPU_GROUPS = 132, 4


def gpu_workers(blocks: int) -> int:
    """Groups of lanes at work at a time, of a kernel of which a multiprocessor holds so many blocks."""
    return GPU_MULTIPROCESSORS * GPU_GROUPS * blocks


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return false;
#else
    return true;
#endif
"""
)
def on_cpu() -> bool:
    """Whether this is a CPU. Known when a kernel is compiled, so that what is not for the device costs it nothing."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    asm volatile("" : "+r"(count));
#endif
    return count;
"""
)
def unknown(count: int) -> int:
    """A number that a GPU's compiler does not know, so that it does not write out a loop of so many turns.

    What a multiprocessor works at must fit into its cache for instructions, see bench/NOTES.md.
    """
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __ballot_sync(0xffffffffu, keep);
#else
    return keep ? 1u : 0u;
#endif
"""
)
def ballot(keep: bool) -> wp.uint32:
    """One bit for each lane of the group."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __popc(mask & ((1u << lane) - 1u));
#else
    return 0;
#endif
"""
)
def rank(mask: wp.uint32, lane: int) -> int:
    """How many lanes before this one are in the mask."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __popc(mask);
#else
    return mask;
#endif
"""
)
def members(mask: wp.uint32) -> int:
    """How many lanes are in the mask."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __ffs(mask) - 1;
#else
    return 0;
#endif
"""
)
def first_member(mask: wp.uint32) -> int:
    """The first lane in the mask, which must not be empty."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    unsigned long long key = ((unsigned long long)__float_as_uint(value) << 32) | (unsigned)lane;
    for (int step = 16; step > 0; step >>= 1) {
        unsigned long long other = __shfl_xor_sync(0xffffffffu, key, step);
        key = other < key ? other : key;
    }
    return key & 31u;
#else
    return 0;
#endif
"""
)
def lane_of_least(value: float, lane: int) -> int:
    """The lane with the least value; values must not be negative."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1)
        value = fminf(value, __shfl_xor_sync(0xffffffffu, value, step));
#endif
    return value;
"""
)
def least_of_lanes(value: float) -> float:
    """The least of all lanes' values, the same for each."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1)
        value = min(value, __shfl_xor_sync(0xffffffffu, value, step));
#endif
    return value;
"""
)
def least_whole_of_lanes(value: int) -> int:
    """The least of all lanes' whole numbers, the same for each."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1)
        value += __shfl_xor_sync(0xffffffffu, value, step);
#endif
    return value;
"""
)
def sum_of_lanes(value: float) -> float:
    """The sum of all lanes' values, the same for each."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1)
        value += __shfl_xor_sync(0xffffffffu, value, step);
#endif
    return value;
"""
)
def sum_of_lanes_in_double(value: wp.float64) -> wp.float64:
    """`sum_of_lanes` in float64."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    for (int step = 1; step < 4; step <<= 1)
        value += __shfl_xor_sync(0xffffffffu, value, step);
#endif
    return value;
"""
)
def sum_of_four(value: float) -> float:
    """The sum of the values of each four neighbouring lanes, the same for each."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, value, source);
#else
    return value;
#endif
"""
)
def from_lane(value: float, source: int) -> float:
    """Another lane's value."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, value, source);
#else
    return value;
#endif
"""
)
def int_from_lane(value: int, source: int) -> int:
    """Another lane's whole number."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    __syncwarp();
#endif
"""
)
def wait_for_lanes():
    """What the group's lanes wrote before is there for all of them afterwards."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __fdividef(a, b);
#else
    return a / b;
#endif
"""
)
def about_quotient(a: float, b: float) -> float:
    """a / b to within two roundings, and 0 where |b| is more than 2^126: a third of the instructions on a GPU."""
    ...


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
    return atomicAdd(counts.data + index, value);
#else
    return __atomic_fetch_add(counts.data + index, value, __ATOMIC_RELAXED);
#endif
"""
)
def fetch_add(counts: wp.array(dtype=wp.int32), index: int, value: int) -> int:
    """Add to a count that other threads add to as well; returns what it was before."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    atomicMin(values.data + index, value);
#else
    int* at = values.data + index;
    int before = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (value < before && !__atomic_compare_exchange_n(at, &before, value, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED))
        ;
#endif
"""
)
def keep_least(values: wp.array(dtype=wp.int32), index: int, value: int):
    """Bring a value down to another if it is larger, while others do the same."""
    ...


@wp.func_native(
    snippet="""
    // Floats without a sign are in the order of their bits, those with one in the other order.
    int* at = reinterpret_cast<int*>(values.data) + index;
    const int bits = *reinterpret_cast<int*>(&value);
#if defined(__CUDA_ARCH__)
    if (bits >= 0)
        atomicMin(at, bits);
    else
        atomicMax(reinterpret_cast<unsigned*>(at), (unsigned)bits);
#else
    union { int i; float f; } now;
    now.i = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (value < now.f && !__atomic_compare_exchange_n(at, &now.i, bits, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED))
        ;
#endif
"""
)
def lessen(values: wp.array(dtype=wp.float32), index: int, value: float):
    """Bring a value down to another if it is larger, while others do the same."""
    ...


@wp.func_native(
    snippet="""
    // With the sign bit the same, floats are ordered by magnitude as their bits are.
    unsigned* at = reinterpret_cast<unsigned*>(values.data) + index;
    const unsigned bits = (*at & 0x80000000u) | (0x7fffffffu & *reinterpret_cast<unsigned*>(&size));
#if defined(__CUDA_ARCH__)
    atomicMin(at, bits);
#else
    unsigned before = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (bits < before && !__atomic_compare_exchange_n(at, &before, bits, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED))
        ;
#endif
"""
)
def shrink(values: wp.array(dtype=wp.float32), index: int, size: float):
    """Bring a value's magnitude down to `size` if it is larger, while others do the same; its sign stays."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    int item = 0;
    if (lane == 0)
        item = atomicAdd(counts.data + index, value);
    return __shfl_sync(0xffffffffu, item, 0);
#else
    return __atomic_fetch_add(counts.data + index, value, __ATOMIC_RELAXED);
#endif
"""
)
def fetch_add_once(counts: wp.array(dtype=wp.int32), index: int, value: int, lane: int) -> int:
    """`fetch_add` by one lane for the whole group; every lane gets the result."""
    ...


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
    const float* v = data.data + 4 * index;
    return wp::vec4(v[0], v[1], v[2], v[3]);
#endif
"""
)
def read4(data: wp.array(dtype=wp.float32), index: int) -> wp.vec4:
    """Four floats at 4 * index in one access, of an array that this kernel writes too."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    reinterpret_cast<float4*>(data.data)[index] = make_float4(x, y, z, w);
#else
    float* v = data.data + 4 * index;
    v[0] = x; v[1] = y; v[2] = z; v[3] = w;
#endif
"""
)
def write4(data: wp.array(dtype=wp.float32), index: int, x: float, y: float, z: float, w: float):
    """Four floats to 4 * index in one access."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    reinterpret_cast<float4*>(data.data)[index] = make_float4(x, y, z, w);
#else
    float* v = reinterpret_cast<float*>(data.data) + 4 * index;
    v[0] = x; v[1] = y; v[2] = z; v[3] = w;
#endif
"""
)
def write4_of_vectors(data: wp.array(dtype=wp.vec3), index: int, x: float, y: float, z: float, w: float):
    """`write4` to an array of three-vectors that lie one behind the other."""
    ...
