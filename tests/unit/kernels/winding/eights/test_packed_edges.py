"""Shares of winding numbers by packed edges are right within their errors, in boxes and at single places."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from sdm.bench.common.dirty_meshes.by_code import boxes, half_spheres, loose, sheets, torn, turned
from sdm.bench.common.meshes import torus
from sdm.engine.acceleration import build
from sdm.kernels.bvh.tree import SCALE, Tree
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU
from sdm.kernels.primitives.wide_numbers import SIXTEEN
from sdm.kernels.winding.boundary_term import Boundary, boundary_winding
from sdm.kernels.winding.cap_field import doubt, share_at
from sdm.kernels.winding.eights.box_strips import ERROR, SHARE, X, Y, Z, strips_of_box
from sdm.kernels.winding.eights.box_strips import ROOM as PLACES
from sdm.kernels.winding.eights.packed_edges import ROW, look_at_eights, pack_edges, sum_of_eights
from sdm.kernels.winding.rims.radial_strips import ACROSS_BOX, NEAR
from sdm.kernels.winding.rims.strip_looks import field_of

POINTS = SIXTEEN
ROOM = 2000


@wp.kernel(enable_backward=False)
def _look(
    tree: Tree,
    boundary: Boundary,
    rows: wp.array(dtype=wp.float32),
    count: int,
    numbers: wp.array(dtype=wp.float32),
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
    look = look_at_eights(rows, 0, count, c, radius, half, tolerance, stack, 0, ROOM, ROOM, ROOM)
    field = field_of(look, 1)
    near, across = int(look[NEAR]), int(look[ACROSS_BOX])
    at = PLACES * i
    for k in range(POINTS):
        p = c + radius * ways[i, k]
        for axis in range(3):
            numbers[at + SIXTEEN * axis + k] = p[axis]
    strips_of_box(rows, 0, stack, 0, near, ROOM, across, c, radius, numbers, at, POINTS, 1)
    for k in range(POINTS):
        p = wp.vec3(numbers[at + X + k], numbers[at + Y + k], numbers[at + Z + k])
        exact = boundary_winding(boundary, tree, 0, wp.vec3d(p))
        found[i, 2 * k, 0] = wp.abs(wp.float64(share_at(field, p - c) + numbers[at + SHARE + k]) - exact)
        found[i, 2 * k, 1] = wp.float64(doubt(field) + numbers[at + ERROR + k])
        whole = sum_of_eights(rows, 0, count, p)
        found[i, 2 * k + 1, 0] = wp.abs(wp.float64(whole[0]) - exact)
        found[i, 2 * k + 1, 1] = wp.float64(whole[1])


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-3, 1e-5])
@pytest.mark.parametrize(
    "mesh",
    [torn(torus(2000), 0.1), half_spheres(6), sheets(12), boxes(12), loose(torus(300), 0.01), turned(torus(300), 0.5)],
    ids=["torn", "half spheres", "sheets", "boxes", "loose", "turned"],
)
def test_shares_are_right_within_their_errors(mesh, tolerance):
    vertices, faces = mesh
    structure = build(torch.from_numpy(vertices)[None], torch.from_numpy(faces))
    tree, winding = structure.view[:2]
    boundary = winding.boundary
    scale = float(tree.frame.numpy()[SCALE])
    rng = np.random.default_rng(0)
    count = 150
    low, high = vertices.min(0), vertices.max(0)
    radius = 10.0 ** rng.uniform(-3, -0.7, (count, 1))
    centres = scale * (low + (high - low) * rng.uniform(-0.2, 1.2, (count, 3)))
    # Some at ends of edges, and on the line along x through one.
    ends = boundary.ends.numpy()
    centres[:10] = ends[:10]
    centres[10:20] = ends[10:20] + np.array([0.25, 0, 0])
    ways = rng.normal(size=(count, POINTS, 3))
    ways *= rng.uniform(0, 1, (count, POINTS, 1)) / np.linalg.norm(ways, axis=2, keepdims=True)
    ways[:20, 0] = 0
    blocks = -(-boundary.count // SIXTEEN)
    rows, packed = wp.zeros(ROW * blocks, dtype=wp.float32, device="cpu"), wp.zeros(1, dtype=int, device="cpu")
    wp.launch(pack_edges, 1, inputs=[0, boundary, blocks, rows, packed], device="cpu")
    length = int(packed.numpy()[0])
    assert length == len(np.unique(ends.reshape(-1, 6), axis=0))
    found = wp.zeros((count, 2 * POINTS, 2), dtype=wp.float64, device="cpu")
    given = [
        rows,
        length,
        wp.zeros(count * PLACES, dtype=wp.float32, device="cpu"),
        wp.array(np.hstack([centres, radius]).astype(np.float32), dtype=wp.vec4, device="cpu"),
        wp.array(ways.astype(np.float32), dtype=wp.vec3, device="cpu"),
        tolerance,
        wp.zeros((count, LARGE_STACK_ON_CPU), dtype=int, device="cpu"),
    ]
    wp.launch(_look, count, inputs=[tree, boundary, *given, found], device="cpu")
    off, error = np.moveaxis(found.numpy(), 2, 0)
    known = np.isfinite(error)
    assert known[20:].mean() > 0.95
    # With room for the sums' own rounding.
    assert (off <= error + 1e-6)[known].all(), (off - error)[known].max()
    assert np.median(error[:, ::2][known[:, ::2]]) < 2.0 * tolerance + 1e-3
    assert np.median(error[:, 1::2][known[:, 1::2]]) < 1e-4
