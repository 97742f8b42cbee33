"""Single voxels by the sum over all boundary edges in float64, where the sum over all caps in float32 leaves a doubt.

A block of threads looks at each, or where voxels are few so many of them at one: a multiprocessor has half as many
units for float64, and would be busy with one voxel for as long as a GPU with all that were looked at before. The
threads share the crossings with a ray, too: one of them alone would wait for node after node.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree
from sdm.kernels.geometry.voxel_grid import Slab, unravel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import arrive
from sdm.kernels.winding.boundary_term import Boundary, boundary_part
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.rims.single_voxels import THREADS, crossings_part, next_of_block, place_of_voxel, sum_of_block
from sdm.kernels.winding.settled_boxes import opened

wp.set_module_options({"enable_backward": False})

# Thread blocks that a multiprocessor holds at a time, and blocks at one voxel, at most.
BLOCKS, MOST = 2, 8


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return __ldcg(numbers.data + at);
#else
    return numbers.data[at];
#endif
"""
)
def number_of_other(numbers: wp.array(dtype=wp.float64), at: int) -> wp.float64:
    """A number that another block of threads has written."""
    ...


@wp.kernel(launch_bounds=(THREADS, BLOCKS))
def _sum_exactly(
    begin: int,
    lanes: int,
    groups: int,
    tree: Tree,
    boundary: Boundary,
    caps: Caps,
    slab: Slab,
    voxels: wp.array(dtype=wp.int32),
    listed: int,
    next_item: int,
    arrived: int,
    parts: wp.array(dtype=wp.float64),
    counts: wp.array(dtype=wp.int32),
    values: wp.array4d(dtype=wp.float32),
):
    """Open the voxels of a list. `listed`, `next_item` and `arrived` are places of the counts: how many there are,
    which is next, and for each that several blocks look at how many of these are done.
    """
    lane = (begin + wp.tid()) % lanes
    total = counts[listed]
    shares = int(1)
    while 2 * shares <= MOST and 2 * shares * total <= groups:
        shares = 2 * shares
    item = next_of_block(counts, next_item)
    while item < total * shares:
        number = item / shares
        share = item - number * shares
        mesh, v = unravel(voxels[number], slab.shape)
        p = place_of_voxel(tree, slab, mesh, v)
        first = share * lanes + lane
        crossings = int(0)
        if caps.are_faces != 0:
            crossings = crossings_part(tree, mesh, p, first, shares * lanes)
        else:
            crossings = crossings_part(caps.tree, mesh, p, first, shares * lanes)
        met = sum_of_block(wp.float64(crossings))
        winding = sum_of_block(boundary_part(boundary, tree, mesh, p, first, shares * lanes))
        if lane == 0:
            done = int(1)
            if shares > 1:
                parts[2 * item] = met
                parts[2 * item + 1] = winding
                done = arrive(counts, arrived + number) + 1
            if done == shares:
                if shares > 1:
                    met = wp.float64(0.0)
                    winding = wp.float64(0.0)
                    for other in range(shares):
                        met = met + number_of_other(parts, 2 * (number * shares + other))
                        winding = winding + number_of_other(parts, 2 * (number * shares + other) + 1)
                # Without the caps: the crossings of the surface alone.
                whole = values[mesh, v[0], v[1], v[2]]
                whole = wp.where(caps.are_faces != 0, float(met), whole - float(met))
                # A whole number is what others would look at again.
                values[mesh, v[0], v[1], v[2]] = opened(whole + float(winding))
        item = next_of_block(counts, next_item)


def groups_at_work(device: wp.Device) -> int:
    """Blocks of threads that are at work at a time, for each of which there is a count from `arrived` on."""
    return BLOCKS * device.sm_count if device.is_cuda else threads()


def sum_exactly(
    tree: Tree, boundary: Boundary, caps: Caps, slab: Slab, voxels: wp.array, listed: int, next_item: int, arrived: int,
    counts: wp.array, values: wp.array, parts: wp.array,
) -> None:  # fmt: skip
    """Launch it; for the arguments see there. `parts`: (2 * groups_at_work) float64, workspace."""
    device = values.device
    lanes, groups = (THREADS if device.is_cuda else 1), groups_at_work(device)
    inputs = [lanes, groups, tree, boundary, caps, slab, voxels, listed, next_item, arrived, parts, counts, values]
    launch(_sum_exactly, groups * lanes, inputs, device, lanes, smallest=1)
