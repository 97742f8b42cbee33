"""Shares of the winding number by polynomials of edges, and by float32's sum, are right within their errors."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from sdm.bench.common.dirty_meshes.by_code import boxes, half_spheres, sheets, torn
from sdm.bench.common.meshes import torus
from sdm.engine.acceleration import build
from sdm.kernels.bvh.tree import SCALE, Tree
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU
from sdm.kernels.winding.boundary_term import Boundary, boundary_winding
from sdm.kernels.winding.cap_field import Field, doubt, moved_field, share_at
from sdm.kernels.winding.rims.edge_boxes import ROOM, ROOM_OF_OCTANT, with_share
from sdm.kernels.winding.rims.float32_sum import listed_sum, rim_part
from sdm.kernels.winding.rims.strip_polynomials import see_edges

POINTS = 8


@wp.kernel(enable_backward=False)
def _look(
    tree: Tree,
    boundary: Boundary,
    boxes: wp.array(dtype=wp.vec4),
    ways: wp.array2d(dtype=wp.vec3),
    tolerance: float,
    stacks: wp.array2d(dtype=int),
    found: wp.array3d(dtype=wp.float64),
):
    i = wp.tid()
    stack = stacks[i]
    whole = VoxelBox()
    whole.centre = wp.vec3(boxes[i][0], boxes[i][1], boxes[i][2])
    whole.half2 = boxes[i][3] * boxes[i][3]
    seen = see_edges(boundary, 0, boundary.count, 0, whole, tolerance, stack, 0, 0, ROOM, Field(), 0, 1)
    listed = wp.min(seen.near, ROOM)
    less = listed_sum(boundary.ends, stack, 0, listed, whole.centre, 0, 1)
    field = with_share(seen.field, rim_part(boundary, 0, whole.centre, 0, 1))
    field = with_share(field, wp.vec2(-less[0], less[1]))
    # A part of half the radius, somewhere in it.
    box = VoxelBox()
    box.centre = whole.centre + 0.5 * boxes[i][3] * ways[i, 0]
    box.half2 = 0.25 * whole.half2
    found_here = listed_sum(boundary.ends, stack, 0, listed, box.centre, 0, 1)
    inner = see_edges(
        boundary, 0, listed, 1, box, tolerance, stack, 0, ROOM, ROOM_OF_OCTANT,
        moved_field(field, box.centre - whole.centre), 0, 1,
    )  # fmt: skip
    near = wp.min(inner.near, ROOM_OF_OCTANT)
    less_here = listed_sum(boundary.ends, stack, ROOM, near, box.centre, 0, 1)
    part = with_share(with_share(inner.field, found_here), wp.vec2(-less_here[0], less_here[1]))
    for k in range(ways.shape[1]):
        p = whole.centre + boxes[i][3] * ways[i, k]
        exact = boundary_winding(boundary, tree, 0, wp.vec3d(p))
        some = listed_sum(boundary.ends, stack, 0, listed, p, 0, 1)
        found[i, 2 * k, 0] = wp.abs(wp.float64(share_at(field, p - whole.centre) + some[0]) - exact)
        found[i, 2 * k, 1] = wp.float64(doubt(field) + some[1])
        q = box.centre + 0.5 * boxes[i][3] * ways[i, k]
        exact = boundary_winding(boundary, tree, 0, wp.vec3d(q))
        some = listed_sum(boundary.ends, stack, ROOM, near, q, 0, 1)
        found[i, 2 * k + 1, 0] = wp.abs(wp.float64(share_at(part, q - box.centre) + some[0]) - exact)
        found[i, 2 * k + 1, 1] = wp.float64(doubt(part) + some[1])


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-5])
@pytest.mark.parametrize(
    "mesh",
    [torn(torus(2000), 0.1), half_spheres(6), sheets(12), boxes(12)],
    ids=["torn", "half spheres", "sheets", "boxes"],
)
def test_shares_are_right_within_their_errors(mesh, tolerance):
    vertices, faces = mesh
    structure = build(torch.from_numpy(vertices)[None], torch.from_numpy(faces))
    tree, winding = structure.view[:2]
    scale = float(tree.frame.numpy()[SCALE])
    rng = np.random.default_rng(0)
    count = 150
    low, high = vertices.min(0), vertices.max(0)
    radius = 10.0 ** rng.uniform(-3, -0.7, (count, 1))
    centres = scale * (low + (high - low) * rng.uniform(-0.2, 1.2, (count, 3)))
    ways = rng.normal(size=(count, POINTS, 3))
    ways *= rng.uniform(0, 1, (count, POINTS, 1)) / np.linalg.norm(ways, axis=2, keepdims=True)
    found = wp.zeros((count, 2 * POINTS, 2), dtype=wp.float64)
    given = [
        wp.array(np.hstack([centres, radius]).astype(np.float32), dtype=wp.vec4),
        wp.array(ways.astype(np.float32), dtype=wp.vec3),
        tolerance,
        wp.zeros((count, LARGE_STACK_ON_CPU), dtype=int),
    ]
    wp.launch(_look, count, inputs=[tree, winding.boundary, *given, found], device="cpu")
    off, error = np.moveaxis(found.numpy(), 2, 0)
    known = np.isfinite(error)
    assert known.mean() > 0.7
    # With room for the sums' own rounding.
    assert (off <= error + 1e-6)[known].all(), (off - error)[known].max()
    assert np.median(error[known]) < 2.0 * tolerance + 1e-3
