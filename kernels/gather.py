"""Which triangles matter to a group of points: by the tree, all lanes together.

A tree of two children a node is narrow at the top, where a descent by levels leaves most lanes idle. So each lane takes
a descendant as many levels down as fills the lanes: its number follows from its ancestor's, and whatever its ancestors'
tests would have dropped, its own does too.

Found slots are left in the worker's scratch. A list too long for it is given up: its points are then searched one by
one, which is slower, never wrong.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.closest import slot_part
from sdm.kernels.cones import Cones
from sdm.kernels.crossings import Ray, meets_ray
from sdm.kernels.cull import Cell, Witness
from sdm.kernels.lanes import GPU_LANES, from_lane, int_from_lane, lane_of_least, on_cpu, wait_for_lanes
from sdm.kernels.leaves import full_of_leaves, push, triangles_that_matter
from sdm.kernels.regions import node_matters
from sdm.kernels.tree import TRIANGLES_PER_LEAF, Tree, first_triangle, node_distance2

wp.set_module_options({"enable_backward": False})

# A worker's scratch: nodes, of which each level leaves at most 32 more than it takes, at each of up to 27 levels, and
# 64 of one batch; leaves, of which at most 7 wait for the 64 of one batch; the triangles found, at most MOST and the 32
# of one batch; of these each lane's own, and of its own those that tie, with their squared distances (`shortlist`).
LEAVES, FOUND = 1024, 1152
MOST, OWN_ROOM, TIES_ROOM = 6144, 256, 32
OWN = FOUND + MOST + 128
TIES = OWN + OWN_ROOM * GPU_LANES
SQUARES = TIES + TIES_ROOM * GPU_LANES
SCRATCH = SQUARES + TIES_ROOM * GPU_LANES

_LEAVES, _FOUND = wp.constant(LEAVES), wp.constant(FOUND)
_MOST = wp.constant(MOST)
_LEAF = wp.constant(TRIANGLES_PER_LEAF)


@wp.struct
class Descent:
    """Nodes and leaves that wait in a worker's scratch, and a lane's node."""

    waiting: wp.int32
    ripe: wp.int32
    node: wp.int32  # 0 for none


@wp.func
def start_descent(tree: Tree, scratch: wp.array(dtype=wp.int32), at: int, lane: int):
    """From the root."""
    descent = Descent()
    if lane == 0:
        scratch[at] = 1
        scratch[at + _LEAVES] = 0
    if tree.depth > 0:
        descent.waiting = 1
    else:
        descent.ripe = 1
    wait_for_lanes()
    return descent


@wp.func
def next_nodes(tree: Tree, scratch: wp.array(dtype=wp.int32), at: int, descent: Descent, lane: int, lanes: int):
    """Take waiting nodes, and give each lane one of them or of their descendants that is no leaf."""
    taken = wp.min(lanes, descent.waiting)
    down = int(0)
    while (taken << (down + 1)) <= lanes:
        down = down + 1
    descent.waiting = descent.waiting - taken
    descent.node = 0
    which = lane >> down
    if which < taken:
        node = scratch[at + descent.waiting + which]
        # Above the last level there may be fewer.
        levels = down
        while (node << levels) >= (1 << tree.depth):
            levels = levels - 1
        number = lane - (which << down)
        if number < (1 << levels):
            descent.node = (node << levels) + number
    wait_for_lanes()
    return descent


@wp.func
def keep_children(
    tree: Tree, scratch: wp.array(dtype=wp.int32), at: int, descent: Descent, child: int, keep: bool, lane: int
):
    """Let the lanes' children that they keep wait, as nodes or as leaves."""
    leaves = 1 << tree.depth
    descent.waiting = descent.waiting + push(scratch, at + descent.waiting, keep and child < leaves, child, lane)
    descent.ripe = descent.ripe + push(
        scratch, at + _LEAVES + descent.ripe, keep and child >= leaves, child - leaves, lane
    )
    return descent


@wp.func
def greedy_leaf_of_lanes(tree: Tree, p: wp.vec3, lane: int, lanes: int):
    """A leaf near p: as many levels at a time as the lanes see, always to the nearest node."""
    leaves = 1 << tree.depth
    node = int(1)
    while node < leaves:
        levels = int(0)
        while (2 << levels) <= lanes and (node << (levels + 1)) < leaves:
            levels = levels + 1
        # Each lane sees both children of its node; lanes without one see another's.
        below = (node << levels) + lane % (1 << levels)
        left2 = node_distance2(tree, 2 * below, p)
        right2 = node_distance2(tree, 2 * below + 1, p)
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
        slot = first_triangle(tree, leaf)
        end = first_triangle(tree, leaf + 1)
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
    """The slot of the triangle nearest to p (scaled), as float32 sees it, by all lanes together."""
    leaf = greedy_leaf_of_lanes(tree, p, lane, lanes)
    # A leaf of a small mesh may be empty.
    best, best2 = nearest_of_leaves(tree, p, leaf, 0, float(wp.inf), lane)
    descent = start_descent(tree, scratch, at, lane)
    while descent.waiting + descent.ripe > 0:
        if descent.waiting > 0 and descent.ripe < full_of_leaves(lanes):
            descent = next_nodes(tree, scratch, at, descent, lane, lanes)
            for side in range(2):
                child = 2 * descent.node + side
                keep = False
                if descent.node > 0:
                    keep = node_distance2(tree, child, p) < best2
                descent = keep_children(tree, scratch, at, descent, child, keep, lane)
        else:
            taken = wp.min(full_of_leaves(lanes), descent.ripe)
            descent.ripe = descent.ripe - taken
            leaf = int(-1)
            which = lane / _LEAF
            if which < taken:
                leaf = scratch[at + _LEAVES + descent.ripe + which]
                if node_distance2(tree, (1 << tree.depth) + leaf, p) >= best2:
                    leaf = -1
            best, best2 = nearest_of_leaves(tree, p, leaf, best, best2, lane)
        wait_for_lanes()
    return best


@wp.func
def gather_near(
    tree: Tree,
    balls: wp.array(dtype=wp.float32),
    cones: Cones,
    cell: Cell,
    known: Witness,
    scratch: wp.array(dtype=wp.int32),
    at: int,
    lane: int,
    lanes: int,
):
    """Find the triangles that may be nearest to a point of the cell; returns how many, or -1 if there is no room."""
    radius = wp.sqrt(cell.half2)
    descent = start_descent(tree, scratch, at, lane)
    found = int(0)
    while descent.waiting + descent.ripe > 0 and found <= _MOST:
        if descent.waiting > 0 and descent.ripe < full_of_leaves(lanes):
            descent = next_nodes(tree, scratch, at, descent, lane, lanes)
            for side in range(2):
                child = 2 * descent.node + side
                keep = False
                if descent.node > 0:
                    keep = node_matters(cell, radius, known, tree, cones, 0, child)
                descent = keep_children(tree, scratch, at, descent, child, keep, lane)
        else:
            taken = wp.min(full_of_leaves(lanes), descent.ripe)
            descent.ripe = descent.ripe - taken
            found = found + triangles_that_matter(
                cell,
                radius,
                known,
                tree,
                balls,
                cones,
                0,
                scratch,
                at + _LEAVES + descent.ripe,
                taken,
                at + _FOUND + found,
                lane,
                lanes,
            )
        wait_for_lanes()
    return wp.where(found <= _MOST, found, -1)


@wp.func
def triangle_meets(tree: Tree, slot: int, ray: Ray, low: wp.vec2i, high: wp.vec2i):
    """Whether a triangle may be met by a ray along x from a box whose (y,z) on the lattice are from `low` to `high`."""
    a = tree.lattice[3 * slot]
    b = tree.lattice[3 * slot + 1]
    c = tree.lattice[3 * slot + 2]
    if wp.min(a[0], wp.min(b[0], c[0])) > high[0] or wp.max(a[0], wp.max(b[0], c[0])) < low[0]:
        return False
    if wp.min(a[1], wp.min(b[1], c[1])) > high[1] or wp.max(a[1], wp.max(b[1], c[1])) < low[1]:
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
    while descent.waiting + descent.ripe > 0 and found <= _MOST:
        if descent.waiting > 0 and descent.ripe < full_of_leaves(lanes):
            descent = next_nodes(tree, scratch, at, descent, lane, lanes)
            for side in range(2):
                child = 2 * descent.node + side
                keep = False
                if descent.node > 0:
                    keep = meets_ray(tree, child, ray)
                descent = keep_children(tree, scratch, at, descent, child, keep, lane)
        else:
            taken = wp.min(full_of_leaves(lanes), descent.ripe)
            descent.ripe = descent.ripe - taken
            i = lane
            while i - lane < taken * _LEAF:
                keep = False
                slot = int(0)
                if i < taken * _LEAF:
                    leaf = scratch[at + _LEAVES + descent.ripe + i / _LEAF]
                    slot = first_triangle(tree, leaf) + i % _LEAF
                    if slot < first_triangle(tree, leaf + 1):
                        keep = triangle_meets(tree, slot, ray, low, high)
                found = found + push(scratch, at + _FOUND + found, keep, slot, lane)
                i = i + lanes
        wait_for_lanes()
    return wp.where(found <= _MOST, found, -1)
