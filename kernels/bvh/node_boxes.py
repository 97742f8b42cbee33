"""Boxes of the nodes of a bounding volume hierarchy, level by level from the leaves."""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import BY_FACES, Tree, first_triangle, load_corners, nodes_of, slots_of, tree_of, write_box
from sdm.kernels.launch import launch
from sdm.kernels.primitives.lanes import GPU_LANES, across, wait_for_lanes
from sdm.kernels.primitives.vector_loads import read4

wp.set_module_options({"enable_backward": False})

# Most levels that one launch makes.
LEVELS_AT_ONCE = 8


@wp.func
def lowest_box(tree: Tree, mesh: int, node: int):
    """The box of a node whose children have theirs, or of a leaf: from its triangles."""
    low = wp.vec3(wp.inf, wp.inf, wp.inf)
    high = -low
    leaves = 1 << tree.depth
    if node >= leaves:
        for t in range(first_triangle(tree, node - leaves), first_triangle(tree, node - leaves + 1)):
            a, b, c, _normal = load_corners(tree, slots_of(tree, mesh) + t)
            low = wp.min(low, wp.min(a, wp.min(b, c)))
            high = wp.max(high, wp.max(a, wp.max(b, c)))
    else:
        left = 2 * (nodes_of(tree, mesh) + 2 * node)
        low4 = wp.min(read4(tree.boxes, left), read4(tree.boxes, left + 2))
        high4 = wp.max(read4(tree.boxes, left + 1), read4(tree.boxes, left + 3))
        low = wp.vec3(low4[0], low4[1], low4[2])
        high = wp.vec3(high4[0], high4[1], high4[2])
    return low, high


def _bound_levels_kernel(of_faces: Any) -> Any:
    @wp.kernel
    def _bound_levels(begin: int, lanes: int, given_tree: Tree, lowest: int, width: int, most: int):
        """Boxes of up to `most` levels, the lowest of them so many above the leaves: a group of lanes for a node of the
        highest and what is below it, and `width` groups for each mesh.

        From the children's below them, or from the triangles. Lanes tell each other the boxes of the lowest levels.
        """
        tree = of_faces(given_tree)
        thread = begin + wp.tid()
        lane = thread % lanes
        group = thread / lanes
        mesh = group / width
        one = tree_of(tree, mesh)
        levels = wp.min(one.depth - lowest + 1, most)
        highest = one.depth - lowest + 1 - levels
        top = (1 << highest) + group - mesh * width
        # Of meshes that differ, one with fewer levels takes fewer groups.
        if levels <= 0 or top >= 2 << highest:
            return
        base = nodes_of(one, mesh)
        # Levels that lanes make of those below: of 32 nodes beside each other five.
        told = int(0)
        while told < levels - 1 and (2 << told) <= lanes:
            told = told + 1
        node = (top << (levels - 1)) + lane
        while node - lane < (top + 1) << (levels - 1):
            low = wp.vec3()
            high = wp.vec3()
            there = node < (top + 1) << (levels - 1)
            if there:
                low, high = lowest_box(one, mesh, node)
                write_box(one, base + node, low, high)
            for up in range(told):
                for axis in range(3):
                    low[axis] = wp.min(low[axis], across(low[axis], 1 << up))
                    high[axis] = wp.max(high[axis], across(high[axis], 1 << up))
                if there and lane % (2 << up) == 0:
                    write_box(one, base + (node >> (up + 1)), low, high)
            node = node + lanes
        wait_for_lanes()
        for back in range(told + 1, levels):
            down = levels - 1 - back
            node = (top << down) + lane
            while node < (top + 1) << down:
                low, high = lowest_box(one, mesh, node)
                write_box(one, base + node, low, high)
                node = node + lanes
            wait_for_lanes()

    return _bound_levels


_BOUND_LEVELS = [_bound_levels_kernel(own) for own in BY_FACES]


def bound_nodes(tree: Tree, meshes: int) -> None:
    """Fill the boxes of a tree of so many meshes whose triangles are in their order."""
    device: Any = tree.boxes.device
    lanes = GPU_LANES if device.is_cuda else 1
    level = tree.depth + 1
    # A launch costs more than a few boxes one after the other; of several each takes about as many.
    at_once = -(-level // -(-level // LEVELS_AT_ONCE))
    while level > 0:
        lowest, levels = tree.depth + 1 - level, min(level, at_once)
        level -= levels
        inputs = [lanes, tree, lowest, 1 << level, levels]
        launch(_BOUND_LEVELS[not tree.meshes], (meshes << level) * lanes, inputs, device, smallest=64)
