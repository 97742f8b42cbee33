"""Candidate triangles of a packet of points: those that may be nearest, and those that rays from them may meet.

Found slots are left in the worker's scratch. A list too long for it is given up: its points are then searched one by
one, which is slower, never wrong.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import TRIANGLES_PER_LEAF, Tree, first_triangle, nodes_of, slots_of
from sdm.kernels.culling.leaf_filter import full_of_leaves, node_matters, push, triangles_that_matter
from sdm.kernels.culling.normal_cones import Cones
from sdm.kernels.culling.witness_bound import Witness
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.points.group_descent import FOUND, LEAVES, MOST, keep_children, next_nodes, start_descent
from sdm.kernels.primitives.lanes import wait_for_lanes
from sdm.kernels.winding.ray_crossings import Ray, lattice_box, meets_ray

wp.set_module_options({"enable_backward": False})

_LEAF = TRIANGLES_PER_LEAF


@wp.func
def gather_near(
    tree: Tree,
    balls: wp.array(dtype=wp.float32),
    cones: Cones,
    box: VoxelBox,
    known: Witness,
    scratch: wp.array(dtype=wp.int32),
    at: int,
    lane: int,
    lanes: int,
):
    """Find the triangles that may be nearest to a point of the box; returns how many, or -1 if there is no room."""
    radius = wp.sqrt(box.half2)
    descent = start_descent(tree, scratch, at, lane)
    found = int(0)
    while descent.waiting + descent.ripe > 0 and found <= MOST:
        if descent.waiting > 0 and descent.ripe < full_of_leaves(lanes):
            descent = next_nodes(tree, scratch, at, descent, lane, lanes)
            for side in range(2):
                child = 2 * descent.node + side
                keep = False
                if descent.node > 0:
                    keep = node_matters(box, radius, known, tree, cones, nodes_of(tree, 0), child)
                descent = keep_children(tree, scratch, at, descent, child, keep, lane)
        else:
            taken = wp.min(full_of_leaves(lanes), descent.ripe)
            descent.ripe = descent.ripe - taken
            found = found + triangles_that_matter(
                box,
                radius,
                known,
                tree,
                balls,
                cones,
                0,
                scratch,
                at + LEAVES + descent.ripe,
                taken,
                at + FOUND + found,
                lane,
                lanes,
            )
        wait_for_lanes()
    return wp.where(found <= MOST, found, -1)


@wp.func
def triangle_meets(tree: Tree, slot: int, ray: Ray, low: wp.vec2i, high: wp.vec2i):
    """True if a triangle may be met by a ray along x from a box whose (y,z) on the lattice are from `low` to `high`."""
    least, most = lattice_box(tree, slot)
    if least[0] > high[0] or most[0] < low[0] or least[1] > high[1] or most[1] < low[1]:
        return False
    ax = tree.corners[4 * slot][0]
    bx = tree.corners[4 * slot + 1][0]
    cx = tree.corners[4 * slot + 2][0]
    if ray.back != 0:
        return wp.min(ax, wp.min(bx, cx)) <= ray.x
    return wp.max(ax, wp.max(bx, cx)) > ray.x


@wp.func
def gather_on_rays(
    tree: Tree,
    ray: Ray,
    low: wp.vec2i,
    high: wp.vec2i,
    scratch: wp.array(dtype=wp.int32),
    at: int,
    lane: int,
    lanes: int,
):
    """Find the triangles that rays along x from a box may meet; returns how many, or -1 if there is no room.

    `ray` is as wide as the box and begins at its nearer side; `low` and `high` are the box's (y,z) on the lattice.
    """
    descent = start_descent(tree, scratch, at, lane)
    found = int(0)
    while descent.waiting + descent.ripe > 0 and found <= MOST:
        if descent.waiting > 0 and descent.ripe < full_of_leaves(lanes):
            descent = next_nodes(tree, scratch, at, descent, lane, lanes)
            for side in range(2):
                child = 2 * descent.node + side
                keep = False
                if descent.node > 0:
                    keep = meets_ray(tree, nodes_of(tree, 0) + child, ray)
                descent = keep_children(tree, scratch, at, descent, child, keep, lane)
        else:
            taken = wp.min(full_of_leaves(lanes), descent.ripe)
            descent.ripe = descent.ripe - taken
            i = lane
            while i - lane < taken * _LEAF:
                keep = False
                slot = int(0)
                if i < taken * _LEAF:
                    leaf = scratch[at + LEAVES + descent.ripe + i / _LEAF]
                    slot = slots_of(tree, 0) + first_triangle(tree, leaf) + i % _LEAF
                    if slot < slots_of(tree, 0) + first_triangle(tree, leaf + 1):
                        keep = triangle_meets(tree, slot, ray, low, high)
                found = found + push(scratch, at + FOUND + found, keep, slot, lane)
                i = i + lanes
        wait_for_lanes()
    return wp.where(found <= MOST, found, -1)
