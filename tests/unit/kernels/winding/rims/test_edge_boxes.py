"""Shares of winding numbers by strips away from a box's centre, and by float32's sum, are right within their errors."""
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
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU
from sdm.kernels.winding.boundary_term import Boundary, boundary_winding
from sdm.kernels.winding.cap_field import doubt, share_at
from sdm.kernels.winding.rims.float32_sum import rim_part
from sdm.kernels.winding.rims.radial_strips import ACROSS_BOX, NEAR, Eight, look_at_edges, strips_at
from sdm.kernels.winding.rims.strip_looks import field_of

POINTS = 8
ROOM = 1500


@wp.kernel(enable_backward=False)
def _look(
    tree: Tree,
    boundary: Boundary,
    places: wp.array(dtype=wp.vec4),
    ways: wp.array2d(dtype=wp.vec3),
    tolerance: float,
    stacks: wp.array2d(dtype=int),
    found: wp.array3d(dtype=wp.float64),
):
    i = wp.tid()
    stack = stacks[i]
    c = wp.vec3(places[i][0], places[i][1], places[i][2])
    radius = places[i][3]
    half = wp.vec3(radius, radius, radius)
    look = look_at_edges(boundary.ends, 0, boundary.count, c, radius, half, tolerance, stack, 0, ROOM, ROOM, ROOM, 0, 1)
    field = field_of(look, 1)
    near, across = int(look[NEAR]), int(look[ACROSS_BOX])
    for k in range(ways.shape[1]):
        p = c + radius * ways[i, k]
        exact = boundary_winding(boundary, tree, 0, wp.vec3d(p))
        some = strips_at(boundary.ends, stack, 0, near, ROOM, across, c, radius, Eight(p[0]), Eight(p[1]), Eight(p[2]))
        found[i, 2 * k, 0] = wp.abs(wp.float64(share_at(field, p - c) + some[0]) - exact)
        found[i, 2 * k, 1] = wp.float64(doubt(field) + some[8])
        whole = rim_part(boundary, 0, p, 0, 1)
        found[i, 2 * k + 1, 0] = wp.abs(wp.float64(whole[0]) - exact)
        found[i, 2 * k + 1, 1] = wp.float64(whole[1])


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-3, 1e-5])
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
    found = wp.zeros((count, 2 * POINTS, 2), dtype=wp.float64, device="cpu")
    given = [
        wp.array(np.hstack([centres, radius]).astype(np.float32), dtype=wp.vec4, device="cpu"),
        wp.array(ways.astype(np.float32), dtype=wp.vec3, device="cpu"),
        tolerance,
        wp.zeros((count, LARGE_STACK_ON_CPU), dtype=int, device="cpu"),
    ]
    wp.launch(_look, count, inputs=[tree, winding.boundary, *given, found], device="cpu")
    off, error = np.moveaxis(found.numpy(), 2, 0)
    known = np.isfinite(error)
    assert known.mean() > 0.95
    # With room for the sums' own rounding.
    assert (off <= error + 1e-6)[known].all(), (off - error)[known].max()
    assert np.median(error[:, ::2][known[:, ::2]]) < 2.0 * tolerance + 1e-3
    assert np.median(error[:, 1::2][known[:, 1::2]]) < 1e-4
