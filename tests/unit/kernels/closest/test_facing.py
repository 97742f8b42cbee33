"""The triangles that touch a closest point are found node by node, as on a GPU, as by eight boxes at once."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false

from __future__ import annotations

import numpy as np
import torch
import warp as wp

from sdm.bench.common.meshes import torus
from sdm.engine.acceleration import build
from sdm.kernels.bvh.tree import SCALE, Tree, tree_of
from sdm.kernels.closest.facing import Facing, touching_by_eights, touching_by_nodes


@wp.kernel(enable_backward=False)
def _look(tree: Tree, points: wp.array(dtype=wp.vec3d), slots: wp.array(dtype=int), seen: wp.array2d(dtype=int)):
    i = wp.tid()
    slot = slots[i]
    for turn in range(3):
        found = Facing()
        found.least = wp.float64(0.0)
        found.slot = slot
        one = tree_of(tree, 0)
        at = wp.vec3(points[i])
        by_eights = touching_by_eights(one, slot, points[i], at, wp.float64(1.0), turn, found)
        by_nodes = touching_by_nodes(one, slot, points[i], at, wp.float64(1.0), turn, found)
        seen[i, 2 * turn] = by_eights.seen
        seen[i, 2 * turn + 1] = by_nodes.seen
        if by_eights.slot != by_nodes.slot or by_eights.most != by_nodes.most:
            seen[i, 2 * turn + 1] = -1


def test_both_ways_find_the_same_triangles():
    vertices, faces = torus(900)
    structure = build(torch.from_numpy(vertices)[None], torch.from_numpy(faces))
    tree = structure.view[0]
    # Corners, middles of edges, and middles of faces: on six faces, on two, and on one.
    where = np.concatenate([vertices[faces[:200, 0]], vertices[faces[:200, :2]].mean(1), vertices[faces[:200]].mean(1)])
    points = wp.array(float(tree.frame.numpy()[SCALE]) * where.astype(np.float64), dtype=wp.vec3d, device="cpu")
    slot_of = np.argsort(tree.face.numpy())
    slots = wp.array(np.tile(slot_of[:200], 3).astype(np.int32), dtype=int, device="cpu")
    seen = wp.zeros((600, 6), dtype=int, device="cpu")
    wp.launch(_look, 600, inputs=[tree, points, slots, seen], device="cpu")
    # Each but the one that it is given.
    np.testing.assert_array_equal(seen.numpy(), np.repeat([5, 1, 0], 200)[:, None].repeat(6, 1))
