"""Search for the triangle nearest to one point by all lanes of a group together.

One thread's search waits for memory at every node; here a batch of nodes, or the triangles of eight leaves, is one
wait.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import slot_part
from sdm.kernels.bvh.tree import TRIANGLES_PER_LEAF, Tree, first_triangle, node_distance2, nodes_of, slots_of
from sdm.kernels.culling.leaf_filter import full_of_leaves
from sdm.kernels.points.group_descent import LEAVES, keep_children, next_nodes, start_descent
from sdm.kernels.primitives.lanes import from_lane, int_from_lane, lane_of_least, on_cpu, wait_for_lanes

wp.set_module_options({"enable_backward": False})

_LEAF = TRIANGLES_PER_LEAF


@wp.func
def greedy_leaf_of_lanes(tree: Tree, p: wp.vec3, lane: int, lanes: int):
    """A leaf near p: as many levels at a time as the lanes see, always to the nearest node."""
    base = nodes_of(tree, 0)
    leaves = 1 << tree.depth
    node = int(1)
    while node < leaves:
        levels = int(0)
        while (2 << levels) <= lanes and (node << (levels + 1)) < leaves:
            levels = levels + 1
        # Each lane sees both children of its node; lanes without one see another's.
        below = (node << levels) + lane % (1 << levels)
        left2 = node_distance2(tree, base + 2 * below, p)
        right2 = node_distance2(tree, base + 2 * below + 1, p)
        child = 2 * below + wp.where(right2 < left2, 1, 0)
        node = int_from_lane(child, lane_of_least(wp.min(left2, right2), lane))
    return node - leaves


@wp.func
def nearest_of_leaves(tree: Tree, p: wp.vec3, leaf: int, best: int, best2: float, lane: int):
    """The nearer to p of a slot whose squared distance is `best2` and of the lanes' triangles.

    Four lanes share a leaf, which is -1 if there is none; on a CPU one lane goes through it.
    """
    mine = best
    mine2 = best2
    if leaf >= 0:
        slot = slots_of(tree, 0) + first_triangle(tree, leaf)
        end = slots_of(tree, 0) + first_triangle(tree, leaf + 1)
        step = int(1)
        if not on_cpu():
            slot = slot + lane % _LEAF
            step = _LEAF
        while slot < end:
            d2, _part = slot_part(tree, slot, p)
            if d2 < mine2:
                mine2 = d2
                mine = slot
            slot = slot + step
    winner = lane_of_least(mine2, lane)
    return int_from_lane(mine, winner), from_lane(mine2, winner)


@wp.func
def nearest_together(tree: Tree, p: wp.vec3, scratch: wp.array(dtype=wp.int32), at: int, lane: int, lanes: int):
    """The slot of the triangle of one mesh's hierarchy nearest to p (scaled), by float32 and all lanes together."""
    base = nodes_of(tree, 0)
    leaf = greedy_leaf_of_lanes(tree, p, lane, lanes)
    # A leaf of a small mesh may be empty.
    best, best2 = nearest_of_leaves(tree, p, leaf, slots_of(tree, 0), float(wp.inf), lane)
    descent = start_descent(tree, scratch, at, lane)
    while descent.waiting + descent.ripe > 0:
        if descent.waiting > 0 and descent.ripe < full_of_leaves(lanes):
            descent = next_nodes(tree, scratch, at, descent, lane, lanes)
            for side in range(2):
                child = 2 * descent.node + side
                keep = False
                if descent.node > 0:
                    keep = node_distance2(tree, base + child, p) < best2
                descent = keep_children(tree, scratch, at, descent, child, keep, lane)
        else:
            taken = wp.min(full_of_leaves(lanes), descent.ripe)
            descent.ripe = descent.ripe - taken
            leaf = int(-1)
            which = lane / _LEAF
            if which < taken:
                leaf = scratch[at + LEAVES + descent.ripe + which]
                if node_distance2(tree, base + (1 << tree.depth) + leaf, p) >= best2:
                    leaf = -1
            best, best2 = nearest_of_leaves(tree, p, leaf, best, best2, lane)
        wait_for_lanes()
    return best
