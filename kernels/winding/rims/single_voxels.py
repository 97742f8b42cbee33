"""Single voxels in doubt by the sum over all caps in float32, then over all boundary edges in float64.

A block of threads looks at each: a group of lanes took as long for one of them, with some ten thousand caps and edges,
as a GPU for all that it had done before. The threads share the crossings with a ray, too: one of them alone would wait
for node after node.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

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

# Threads of a block on a GPU, and blocks that a multiprocessor holds at a time: where edges are more than so many, more
# threads, as one voxel takes long then.
THREADS, BLOCKS = (256, 512), (3, 1)
MANY_EDGES = 20_000


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


def _sum_of_block(threads: int) -> str:
    return f"""
#if defined(__CUDA_ARCH__)
    __shared__ double sums[{threads} / 32];
    for (int step = 16; step > 0; step >>= 1)
        value += __shfl_xor_sync(0xffffffffu, value, step);
    // All have read what was there before.
    __syncthreads();
    if (threadIdx.x % 32 == 0)
        sums[threadIdx.x / 32] = value;
    __syncthreads();
    value = 0.0;
    for (int k = 0; k < {threads} / 32; ++k)
        value += sums[k];
#endif
    return value;
"""


@wp.func_native(snippet=_sum_of_block(THREADS[0]))
def sum_of_few(value: wp.float64) -> wp.float64:
    """The sum of the values of all threads of a block, the same for each; on a CPU of the only one."""
    ...


@wp.func_native(snippet=_sum_of_block(THREADS[1]))
def sum_of_many(value: wp.float64) -> wp.float64:
    """The same of a block of more threads."""
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


def _sum_voxels_kernel(threads: int, blocks: int, sum_of_block: Any) -> Any:
    @wp.kernel(launch_bounds=(threads, blocks))
    def _sum_voxels(
        begin: int,
        lanes: int,
        tree: Tree,
        boundary: Boundary,
        caps: Caps,
        slab: Slab,
        voxels: wp.array(dtype=wp.int32),
        listed: int,
        next_item: int,
        looked: int,
        exact: int,
        counts: wp.array(dtype=wp.int32),
        values: wp.array4d(dtype=wp.float32),
    ):
        """Open the voxels of a list. `listed`, `next_item`, `looked` and `exact` are places of the counts: how many
        there are, if there was room for them, which is next, how many were looked at here, and how many in float64.
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
            if not sure:
                # Without the caps: the crossings of the surface alone.
                crossings = int(0)
                if caps.are_faces != 0:
                    crossings = crossings_part(tree, mesh, p, lane, lanes)
                else:
                    crossings = crossings_part(caps.tree, mesh, p, lane, lanes)
                met = float(sum_of_block(wp.float64(crossings)))
                winding = float(sum_of_block(boundary_part(boundary, tree, mesh, p, lane, lanes)))
                winding = wp.where(caps.are_faces != 0, met, whole - met) + winding
            if lane == 0:
                if sure:
                    winding = opened(winding)
                else:
                    fetch_add(counts, exact, 1)
                fetch_add(counts, looked, 1)
                values[mesh, v[0], v[1], v[2]] = winding
            item = next_of_block(counts, next_item)

    return _sum_voxels


_SUM_VOXELS = [_sum_voxels_kernel(*own) for own in zip(THREADS, BLOCKS, (sum_of_few, sum_of_many), strict=True)]


def sum_voxels(
    tree: Tree, boundary: Boundary, caps: Caps, slab: Slab, voxels: wp.array, places: Sequence[int], counts: wp.array,
    values: wp.array,
) -> None:  # fmt: skip
    """Launch it; for the arguments see there."""
    device = values.device
    many = int(boundary.count > MANY_EDGES)
    lanes, blocks = (THREADS[many], BLOCKS[many] * device.sm_count) if device.is_cuda else (1, threads())
    inputs = [lanes, tree, boundary, caps, slab, voxels, *places, counts, values]
    launch(_SUM_VOXELS[many], blocks * lanes, inputs, device, lanes, smallest=1)
