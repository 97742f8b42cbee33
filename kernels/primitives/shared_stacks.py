"""Stacks of a group of lanes in shared memory: nodes, leaves, triangles, features, as whole numbers.

On a CPU they are in an array, of STACK numbers a worker; a GPU takes nothing from it.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.lanes import GPU_GROUPS

wp.set_module_options({"enable_backward": False})

# Every batch of 32 nodes leaves at most 32 more than it took, at each of up to 27 levels; leaves that wait, at most 32
# and the 64 of one batch, grow from the other end.
STACK = 1024
# Three lists of features, of each at most 31 that wait and the 32 of one batch.
SMALL_STACK = 192
# A descent, two lists, of 640 and 320 in shared memory, of 2,048 elsewhere, and there 64 nodes that wait; and last a
# field of so many numbers.
FIELD_PLACES = 32
LARGE_STACK = 1792 + FIELD_PLACES
LARGE_STACK_ON_CPU = 4864 + FIELD_PLACES


def _place(size: int, on_cpu: int = 0) -> str:
    on_cpu = on_cpu or size
    return f"""
#if defined(__CUDA_ARCH__)
    __shared__ __align__(16) wp::int32 shared[{GPU_GROUPS} * {size}];
    return wp::array_t<wp::int32>(shared + threadIdx.x / 32 * {size}, {size});
#else
    return wp::array_t<wp::int32>(stacks.data + (size_t)worker * {on_cpu}, {on_cpu});
#endif
"""


@wp.func_native(snippet=_place(STACK))
def stack_of(stacks: wp.array(dtype=wp.int32), worker: int) -> wp.array(dtype=wp.int32):
    """A worker's stack (STACK): on a GPU in shared memory, which gives back at once what was put there."""
    ...


@wp.func_native(snippet=_place(SMALL_STACK))
def small_stack_of(stacks: wp.array(dtype=wp.int32), worker: int) -> wp.array(dtype=wp.int32):
    """`stack_of` for few (SMALL_STACK), in a kernel that needs its shared memory for something else."""
    ...


@wp.func_native(snippet=_place(LARGE_STACK, LARGE_STACK_ON_CPU))
def large_stack_of(stacks: wp.array(dtype=wp.int32), worker: int) -> wp.array(dtype=wp.int32):
    """`stack_of` for more (LARGE_STACK, or LARGE_STACK_ON_CPU), in a kernel that keeps lists beside its stack."""
    ...
