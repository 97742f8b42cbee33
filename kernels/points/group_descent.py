"""Descent of the tree that all lanes of a group make together.

A tree of two children a node is narrow at the top, where a descent by levels leaves most lanes idle. So each lane takes
a descendant as many levels down as fills the lanes: its number follows from its ancestor's, and whatever its ancestors'
tests would have dropped, its own does too.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree
from sdm.kernels.culling.leaf_filter import push
from sdm.kernels.primitives.lanes import GPU_LANES, wait_for_lanes

wp.set_module_options({"enable_backward": False})

# A worker's scratch: nodes, of which each level leaves at most 32 more than it takes, at each of up to 27 levels, and
# 64 of one batch; leaves, of which at most 7 wait for the 64 of one batch; the triangles found, at most MOST and the 32
# of one batch; of these each lane's own, and of its own those that tie, with their squared distances (`shortlist`).
LEAVES, FOUND = 1024, 1152
MOST, OWN_ROOM, TIES_ROOM = 6144, 128, 32
OWN = FOUND + MOST + 128
TIES = OWN + OWN_ROOM * GPU_LANES
SQUARES = TIES + TIES_ROOM * GPU_LANES
SCRATCH = SQUARES + TIES_ROOM * GPU_LANES


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
        scratch[at + LEAVES] = 0
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
        scratch, at + LEAVES + descent.ripe, keep and child >= leaves, child - leaves, lane
    )
    return descent
