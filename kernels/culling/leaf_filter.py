"""Leaf filter: from leaves of the tree to triangles to features, each kept waiting until there is one for every lane.

A worker's scratch has stacks of triangles (slots), and of features. What is left of a test is pushed onto the next
stack, so that no lane is idle in the tests that cost most. A feature is a number: eight times its triangle's slot, and
which of the triangle's it is: corner 0 to 2, edge 3 to 5, or 6, the face.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import (
    LARGEST_LEAF,
    TRIANGLES_PER_LEAF,
    Tree,
    first_triangle,
    load_corners,
    node_box,
    slots_of,
)
from sdm.kernels.culling.normal_cones import Cones, cone_misses, node_cone
from sdm.kernels.culling.witness_bound import Witness, box_is_farther, triangle_is_farther
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.primitives.fast_math import about_root
from sdm.kernels.primitives.lanes import ballot, members, rank
from sdm.kernels.primitives.vector_loads import load4
from sdm.kernels.primitives.work_queues import one_for_each_bit

wp.set_module_options({"enable_backward": False})

# Where the stacks begin: of triangles of leaves that matter, of those that matter themselves, of their features. A
# batch of lanes leaves at most 31 of what it takes, and brings the triangles of 32 leaves, 32 triangles, or 224
# features.
TRIANGLE_STACK = 0
NEAR_STACK = TRIANGLE_STACK + 32 * (LARGEST_LEAF + 1)
FEATURE_STACK = NEAR_STACK + 64

_LEAF = TRIANGLES_PER_LEAF


@wp.func
def full_of_leaves(lanes: int):
    """Number of leaves that have triangles for all lanes."""
    return wp.max(lanes / _LEAF, 1)


@wp.func
def push(stacks: wp.array(dtype=wp.int32), at: int, keep: bool, entry: int, lane: int):
    """Put the lanes' entries that they keep onto a stack whose top is `at`; returns how many."""
    mask = ballot(keep)
    if keep:
        stacks[at + rank(mask, lane)] = entry
    return members(mask)


@wp.func_native(snippet=one_for_each_bit("wp::int32* queue = stacks.data;", "8 * slot + bit"))
def push_features(stacks: wp.array(dtype=wp.int32), top: int, slot: int, which: int, lane: int) -> int:
    """Push the features `which` (bits) of the lanes' triangles onto a stack; returns the new top."""
    ...


@wp.func_native(snippet=one_for_each_bit("wp::int32* queue = stacks.data;", "slot + bit"))
def push_slots(stacks: wp.array(dtype=wp.int32), top: int, slot: int, which: int, lane: int) -> int:
    """Push the slots from `slot` on whose bit is in `which`; returns the new top."""
    ...


@wp.func
def push_triangles(stacks: wp.array(dtype=wp.int32), top: int, tree: Tree, mesh: int, keep: bool, leaf: int, lane: int):
    """Push the triangles (slots) of the lanes' leaves that they keep; returns the new top."""
    first = int(0)
    which = int(0)
    if keep:
        first = first_triangle(tree, leaf)
        which = (1 << (first_triangle(tree, leaf + 1) - first)) - 1
    return push_slots(stacks, top, slots_of(tree, mesh) + first, which, lane)


@wp.func
def box_matters(
    box: VoxelBox,
    radius: float,
    known: Witness,
    tree: Tree,
    cones: Cones,
    base: int,
    node: int,
    low: wp.vec3,
    high: wp.vec3,
):
    """`node_matters` of a node whose box is known."""
    if box_is_farther(box, known, low, high):
        return False
    across = high - low
    extent = 0.5 * about_root(wp.dot(across, across))
    return not cone_misses(box, radius, 0.5 * (low + high), extent, node_cone(tree, cones, base, node))


@wp.func
def node_matters(box: VoxelBox, radius: float, known: Witness, tree: Tree, cones: Cones, base: int, node: int):
    """True if something in a node's box can be nearest to a voxel of the box of this radius."""
    low, high = node_box(tree, base + node)
    return box_matters(box, radius, known, tree, cones, base, node, low, high)


@wp.func
def triangle_matters(
    box: VoxelBox,
    radius: float,
    known: Witness,
    tree: Tree,
    balls: wp.array(dtype=wp.float32),
    cones: Cones,
    slot: int,
):
    """True if a triangle can be nearest to a voxel of the box of `radius`, by its corners and its cone alone."""
    ball = load4(balls, slot)
    # All loads before the tests, or the second waits for the first.
    cone = load4(cones.triangles, slot)
    a, b, c, _normal = load_corners(tree, slot)
    if cone_misses(box, radius, wp.vec3(ball[0], ball[1], ball[2]), ball[3], cone):
        return False
    return not triangle_is_farther(box, known, a, b, c)


@wp.func
def triangles_that_matter(
    box: VoxelBox,
    radius: float,
    known: Witness,
    tree: Tree,
    balls: wp.array(dtype=wp.float32),
    cones: Cones,
    mesh: int,
    stacks: wp.array(dtype=wp.int32),
    leaves: int,
    taken: int,
    slots: int,
    lane: int,
    lanes: int,
):
    """Push onto `slots` the triangles of the `taken` leaves from `leaves` that matter to a box of this radius.

    That is: whose corners and cone allow that they are nearest to one of its voxels. Returns how many.
    """
    ripe = int(0)
    i = lane
    while i - lane < taken * _LEAF:
        keep = False
        slot = int(0)
        if i < taken * _LEAF:
            leaf = stacks[leaves + i / _LEAF]
            t = first_triangle(tree, leaf) + i % _LEAF
            if t < first_triangle(tree, leaf + 1):
                slot = slots_of(tree, mesh) + t
                keep = triangle_matters(box, radius, known, tree, balls, cones, slot)
        ripe = ripe + push(stacks, slots + ripe, keep, slot, lane)
        i = i + lanes
    return ripe
