"""The boundary's share of the winding number at every voxel of a slab, where that is less work than to ask boxes.

What few boundary edges add to the crossings of the surface is summed up in float32 (`float32_sum`), and in float64
where that leaves a voxel's side open. Neither caps nor boxes are needed, which on a GPU take longer to begin with than
all voxels of a small map.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree
from sdm.kernels.geometry.voxel_grid import Slab, voxel_at
from sdm.kernels.launch import launch
from sdm.kernels.primitives.lanes import (
    GPU_LANES,
    ballot,
    first_member,
    from_lane,
    gpu_workers,
    int_from_lane,
    one_on_cpu,
    sum_of_lanes_in_double,
    sum_of_some,
)
from sdm.kernels.winding.boundary_term import Boundary, boundary_part
from sdm.kernels.winding.rims.float32_sum import rim_part
from sdm.kernels.winding.rims.single_voxels import place_of_voxel
from sdm.kernels.winding.settled_boxes import is_sure, is_whole, opened

wp.set_module_options({"enable_backward": False})

# Edges times voxels that are added up on a GPU in the time that boxes take; and threads that fill one.
MOST_SUMS = {"cuda": 4.5e7, "cpu": 0.0}
THREADS = 1 << 18
# Thread blocks of a multiprocessor that are at it: more would keep out the stages that lists are made by, for which all
# else waits.
RIM_BLOCKS_PER_SM = 6


@wp.kernel
def _add_rims(
    begin: int,
    threads: int,
    most: int,
    tree: Tree,
    boundary: Boundary,
    slab: Slab,
    lanes: int,
    values: wp.array(dtype=wp.float32),
):
    """Add the boundary's share to the crossings of the surface, where that is sure; `lanes` share the edges."""
    thread = begin + wp.tid()
    lanes = one_on_cpu(lanes)
    while thread < most:
        number = thread / lanes
        found = wp.vec2()
        if number < values.shape[0]:
            mesh, at = voxel_at(slab, number)
            found = rim_part(boundary, mesh, wp.vec3(place_of_voxel(tree, slab, mesh, at)), thread % lanes, lanes)
        share = sum_of_some(found[0], lanes)
        error = sum_of_some(found[1], lanes)
        if thread % lanes == 0 and number < values.shape[0]:
            crossings = values[number]
            if is_sure(crossings + share, crossings, error):
                # Whole ones tell what is left.
                values[number] = opened(crossings + share)
        thread = thread + threads


@wp.kernel
def _add_exactly(
    begin: int, tree: Tree, boundary: Boundary, slab: Slab, lanes: int, values: wp.array(dtype=wp.float32)
):
    """The same in float64 where numbers are whole still: of as many voxels as there are lanes, one after the other."""
    thread = begin + wp.tid()
    lane = thread % lanes
    crossings = float(0.5)
    if thread < values.shape[0]:
        crossings = values[thread]
    left = ballot(is_whole(crossings))
    while left != wp.uint32(0):
        source = first_member(left)
        left = left & (left - wp.uint32(1))
        number = int_from_lane(thread, source)
        mesh, at = voxel_at(slab, number)
        part = boundary_part(boundary, tree, mesh, place_of_voxel(tree, slab, mesh, at), lane, lanes)
        winding = from_lane(crossings, source) + float(sum_of_lanes_in_double(part))
        if lane == 0:
            values[number] = winding


def add_rims(tree: Tree, boundary: Boundary, slab: Slab, values: wp.array) -> None:
    """Add to the crossings of each mesh at each voxel, `values` (N,) float32, what its boundary edges leave to add."""
    device, total = values.device, values.shape[0]
    lanes, group = 1, 1
    if device.is_cuda:
        group = GPU_LANES
        while lanes < group and 2 * lanes * total <= THREADS:
            lanes *= 2
    # Whole groups, so that all of their lanes are there to be asked.
    most = -(-total * lanes // group) * group
    at_work = min(most, gpu_workers(device, RIM_BLOCKS_PER_SM) * group) if device.is_cuda else most
    launch(_add_rims, at_work, [at_work, most, tree, boundary, slab, lanes, values], device)
    launch(_add_exactly, -(-total // group) * group, [tree, boundary, slab, group, values], device)
