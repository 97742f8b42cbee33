"""Single voxels in doubt by the sum over all caps in float32.

A block of threads looks at each: a group of lanes took as long for one of them, with some ten thousand caps, as a GPU
for all that it had done before.
"""

from __future__ import annotations

from collections.abc import Sequence

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree, to_lattice, tree_of
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel, voxel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import sum_of_lanes_in_double
from sdm.kernels.winding.all_caps import cap_part
from sdm.kernels.winding.boundary_term import Boundary, boundary_part
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.ray_crossings import count_crossings, crossing_on_ray
from sdm.kernels.winding.settled_boxes import is_sure, opened

wp.set_module_options({"enable_backward": False})

# Threads of a block on a GPU, and blocks that a multiprocessor holds at a time.
THREADS, BLOCKS = 256, 4


@wp.func
def without_caps(tree: Tree, caps: Caps, mesh: int, p: wp.vec3d, whole: float):
    """The crossings of the surface alone by the ray from p (scaled), from the winding number of surface and caps."""
    one = tree_of(caps.tree, mesh)
    if caps.are_faces != 0:
        one = tree_of(tree, mesh)
    crossings = float(count_crossings(one, mesh, p))
    return wp.where(caps.are_faces != 0, crossings, whole - crossings)


@wp.func
def open_voxel(
    tree: Tree,
    boundary: Boundary,
    caps: Caps,
    mesh: int,
    p: wp.vec3d,
    whole: float,
    lane: int,
    lanes: int,
):
    """The winding number at p (scaled) by the sum over all boundary edges, from that of surface and caps."""
    share = sum_of_lanes_in_double(boundary_part(boundary, tree, mesh, p, lane, lanes))
    return without_caps(tree, caps, mesh, p, whole) + float(share)


@wp.func
def crossings_part(tree: Tree, mesh: int, p: wp.vec3d, lane: int, lanes: int):
    """A lane's part of the signed crossings of the ray from p (scaled) along +x with all triangles of a mesh."""
    one = tree_of(tree, mesh)
    q = to_lattice(tree, mesh, p[1], p[2])
    total = int(0)
    t = lane
    while t < one.count:
        total = total + crossing_on_ray(one, one.first + t, q, p[0], False)
        t = t + lanes
    return total


@wp.func
def place_of_voxel(tree: Tree, slab: Slab, mesh: int, v: wp.vec3i):
    """A voxel's place, scaled: a power of two times float32 numbers, which is exact."""
    return tree.frame[mesh * FRAME_SIZE + SCALE] * wp.vec3d(voxel(slab_of(slab, mesh), v[0], v[1], v[2]))


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    __shared__ double sums[{THREADS} / 32];
    for (int step = 16; step > 0; step >>= 1)
        value += __shfl_xor_sync(0xffffffffu, value, step);
    // All have read what was there before.
    __syncthreads();
    if (threadIdx.x % 32 == 0)
        sums[threadIdx.x / 32] = value;
    __syncthreads();
    value = 0.0;
    for (int k = 0; k < {THREADS} / 32; ++k)
        value += sums[k];
#endif
    return value;
"""
)
def sum_of_block(value: wp.float64) -> wp.float64:
    """The sum of the values of all threads of a block, the same for each; on a CPU of the only one."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    __shared__ int item;
    __syncthreads();
    if (threadIdx.x == 0)
        item = atomicAdd(counts.data + place, 1);
    __syncthreads();
    return item;
#else
    return __atomic_fetch_add(counts.data + place, 1, __ATOMIC_RELAXED);
#endif
"""
)
def next_of_block(counts: wp.array(dtype=wp.int32), place: int) -> int:
    """The next item of work for a whole block of threads, counted at a place."""
    ...


@wp.kernel(launch_bounds=(THREADS, BLOCKS))
def _sum_voxels(
    begin: int,
    lanes: int,
    tree: Tree,
    caps: Caps,
    slab: Slab,
    voxels: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    listed: int,
    next_item: int,
    looked: int,
    exact: int,
    counts: wp.array(dtype=wp.int32),
    values: wp.array4d(dtype=wp.float32),
):
    """Open the voxels of a list that are left in no doubt; list the others, for which there is as much room.

    `listed`, `next_item`, `looked` and `exact` are places of the counts: how many there are, if there was room for
    them, which is next, how many were looked at here, and how many others there are.
    """
    lane = (begin + wp.tid()) % lanes
    item = next_of_block(counts, next_item)
    while item < wp.min(counts[listed], voxels.shape[0]):
        mesh, v = unravel(voxels[item], slab.shape)
        p = place_of_voxel(tree, slab, mesh, v)
        whole = values[mesh, v[0], v[1], v[2]]
        found = cap_part(caps, mesh, wp.vec3(p), lane, lanes)
        # A few roundings for the sum of so many.
        share = float(sum_of_block(wp.float64(found[0])))
        error = float(sum_of_block(wp.float64(found[1])))
        winding = whole - share
        sure = is_sure(winding, whole, error)
        if lane == 0:
            if sure:
                values[mesh, v[0], v[1], v[2]] = opened(winding)
            else:
                left[fetch_add(counts, exact, 1)] = voxels[item]
            fetch_add(counts, looked, 1)
        item = next_of_block(counts, next_item)


def sum_voxels(
    tree: Tree, caps: Caps, slab: Slab, voxels: wp.array, left: wp.array, places: Sequence[int], counts: wp.array,
    values: wp.array,
) -> None:  # fmt: skip
    """Launch it; for the arguments see there."""
    device = values.device
    lanes, blocks = (THREADS, BLOCKS * device.sm_count) if device.is_cuda else (1, threads())
    inputs = [lanes, tree, caps, slab, voxels, left, *places, counts, values]
    launch(_sum_voxels, blocks * lanes, inputs, device, lanes, smallest=1)
