"""Nodes of the tree of caps by eights on a CPU: a table of what tells whether they are far, and lists of them."""

from __future__ import annotations

import warp as wp

from sdm.kernels.winding.cap_tree import MOMENTS_SIZE
from sdm.kernels.winding.near_caps import WIDER

wp.set_module_options({"enable_backward": False})

# Places of a worker's stack: nodes of a descent, nodes handed down, those of a box, and caps of eight voxels.
ROOM = 6144
HANDED, LISTED, EXACT = 256, 256 + ROOM, 256 + 2 * ROOM
STACK = 256 + 3 * ROOM
# What is done with nodes that are no part of a field: handed down, or added to voxels; or added to voxels all of them.
HAND_DOWN, MIXED, TO_VOXELS = 0, 1, 2
# A node is no larger than so many radii of a box, when it is handed down; and the least distance from a node in
# parts of that of its centre.
SMALL, NEAREST, LEAST = 1.0, 1.0e-7, 0.1
# Numbers of a node in a table by itself, which are enough to see whether it is far: centre, radius, area, roughness,
# spread, and 4 area r sigma^2, all but the centre with room for rounding.
ROW = 8


@wp.kernel
def pack_nodes(begin: int, moments: wp.array(dtype=wp.float32), rows: wp.array(dtype=wp.float32)):
    """Write the table of all nodes."""
    i = begin + wp.tid()
    m = MOMENTS_SIZE * i
    at = ROW * i
    for k in range(7):
        rows[at + k] = moments[m + k]
    r = WIDER * moments[m + 3]
    sigma = moments[m + 6]
    rows[at + 3] = r
    rows[at + 7] = 4.0 * WIDER * moments[m + 4] * r * sigma * sigma


# Rows of eight numbers of eight nodes, `row[k]` of each, to `v[k]` with the numbers of all.
EIGHT_ROWS = """
        T v[8];
        {
            T a[8], b[8];
            for (int k = 0; k < 8; ++k) __builtin_memcpy(&a[k], row[k], 32);
            for (int k = 0; k < 8; k += 2) {
                b[k] = __builtin_shufflevector(a[k], a[k + 1], 0, 8, 1, 9, 4, 12, 5, 13);
                b[k + 1] = __builtin_shufflevector(a[k], a[k + 1], 2, 10, 3, 11, 6, 14, 7, 15);
            }
            for (int k = 0; k < 8; k += 4) {
                a[k] = __builtin_shufflevector(b[k], b[k + 2], 0, 1, 8, 9, 4, 5, 12, 13);
                a[k + 1] = __builtin_shufflevector(b[k], b[k + 2], 2, 3, 10, 11, 6, 7, 14, 15);
                a[k + 2] = __builtin_shufflevector(b[k + 1], b[k + 3], 0, 1, 8, 9, 4, 5, 12, 13);
                a[k + 3] = __builtin_shufflevector(b[k + 1], b[k + 3], 2, 3, 10, 11, 6, 7, 14, 15);
            }
            for (int k = 0; k < 4; ++k) {
                v[k] = __builtin_shufflevector(a[k], a[k + 4], 0, 1, 2, 3, 8, 9, 10, 11);
                v[k + 4] = __builtin_shufflevector(a[k], a[k + 4], 4, 5, 6, 7, 12, 13, 14, 15);
            }
        }
"""
