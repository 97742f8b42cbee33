"""Single voxels in doubt by the sum over all boundary edges: in float32, then in float64. A group of lanes for each.

As `doubtful_voxels` has it for boxes; voxels of a list are shared out evenly, however many of a box there are.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree
from sdm.kernels.geometry.voxel_grid import Slab, unravel
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, sum_of_lanes, sum_of_lanes_in_double, wait_for_lanes
from sdm.kernels.winding.boundary_term import Boundary, boundary_part
from sdm.kernels.winding.rims.float32_sum import rim_part
from sdm.kernels.winding.rims.single_voxels import place_of_voxel
from sdm.kernels.winding.settled_boxes import is_sure, opened

wp.set_module_options({"enable_backward": False})


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM))
def sum_rims(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    once: Boundary,
    times: wp.array(dtype=wp.int32),
    slab: Slab,
    groups: int,
    voxels: wp.array(dtype=wp.int32),
    listed: int,
    looked: int,
    exact: int,
    counts: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open the voxels of a list, whose values are the crossings of the surface alone: each group every `groups`-th.

    `once` and `times` are those of `edges_once`, for sums in float32. `listed`, `looked` and `exact` are places of the
    counts: how many there are, if there was room for them, how many were looked at, and how many in float64.
    """
    thread = begin + wp.tid()
    lane = thread % lanes
    item = thread / lanes
    while item < wp.min(counts[listed], voxels.shape[0]):
        mesh, v = unravel(voxels[item], slab.shape)
        p = place_of_voxel(tree, slab, mesh, v)
        whole = values[mesh, v[0], v[1], v[2]]
        found = float(times[0]) * rim_part(once, mesh, wp.vec3(p), lane, lanes)
        winding = whole + sum_of_lanes(found[0])
        sure = is_sure(winding, whole, sum_of_lanes(found[1]))
        if not sure:
            winding = whole + float(sum_of_lanes_in_double(boundary_part(boundary, tree, mesh, p, lane, lanes)))
        # All have read the whole number before it goes.
        wait_for_lanes()
        if lane == 0:
            values[mesh, v[0], v[1], v[2]] = opened(winding)
            fetch_add(counts, looked, 1)
            if not sure:
                fetch_add(counts, exact, 1)
        item = item + groups
