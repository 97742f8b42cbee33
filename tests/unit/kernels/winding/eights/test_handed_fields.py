"""Fields that are handed down from a box to a part of it are right within their errors."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from sdm.bench.common.dirty_meshes.by_code import boxes, loose, sheets, turned
from sdm.bench.common.meshes import torus
from sdm.engine.acceleration import build
from sdm.kernels.bvh.tree import SCALE, Tree
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU
from sdm.kernels.primitives.wide_numbers import SIXTEEN
from sdm.kernels.winding.boundary_term import Boundary, boundary_winding
from sdm.kernels.winding.cap_field import doubt, share_at
from sdm.kernels.winding.eights.box_strips import ERROR, SHARE, X, Y, Z, strips_of_box
from sdm.kernels.winding.eights.box_strips import ROOM as PLACES
from sdm.kernels.winding.eights.boxes_handing_down import KEPT, field_of_part
from sdm.kernels.winding.eights.handed_fields import (
    FOUND_ACROSS,
    FOUND_NEAR,
    keep_edges,
    look_at_kept,
    look_at_large,
)
from sdm.kernels.winding.eights.packed_edges import ROW, pack_edges
from sdm.kernels.winding.rims.radial_strips import ACROSS_BOX, NEAR

ROOM = 2000


@wp.kernel(enable_backward=False)
def _hand_down(
    tree: Tree,
    boundary: Boundary,
    rows: wp.array(dtype=wp.float32),
    count: int,
    numbers: wp.array(dtype=wp.float32),
    kept: wp.array(dtype=wp.float32),
    places: wp.array(dtype=wp.vec4),
    parts: wp.array(dtype=wp.vec3),
    ways: wp.array2d(dtype=wp.vec3),
    tolerance: float,
    stacks: wp.array2d(dtype=int),
    found: wp.array3d(dtype=wp.float64),
):
    i = wp.tid()
    stack = stacks[i]
    c = wp.vec3(places[i][0], places[i][1], places[i][2])
    radius = places[i][3]
    half = radius * wp.vec3(1.0)
    large = look_at_large(rows, 0, count, c, radius, half, tolerance, stack, 0, ROOM, ROOM, ROOM)
    near, across = int(large[FOUND_NEAR]), int(large[FOUND_ACROSS])
    at = PLACES * i
    p = c + radius * parts[i]
    for k in range(SIXTEEN):
        for axis in range(3):
            numbers[at + SIXTEEN * axis + k] = p[axis]
    strips_of_box(rows, 0, stack, 0, near, ROOM, across, c, radius, numbers, at, SIXTEEN, 1)
    share, error = numbers[at + SHARE], numbers[at + ERROR]
    keep_edges(rows, 0, stack, 0, near, ROOM, across, kept, KEPT * i)
    small = radius - wp.length(p - c)
    look = look_at_kept(
        kept, KEPT * i / ROW, near, across, p, small, small * wp.vec3(1.0), tolerance, stack, 0, ROOM, ROOM, ROOM
    )
    field = field_of_part(large, p - c, share, error, look)
    for k in range(SIXTEEN):
        for axis in range(3):
            numbers[at + SIXTEEN * axis + k] = p[axis] + small * ways[i, k][axis]
    strips_of_box(
        kept, KEPT * i / ROW, stack, 0, int(look[NEAR]), ROOM, int(look[ACROSS_BOX]), p, small, numbers, at, SIXTEEN, 1
    )
    for k in range(SIXTEEN):
        v = wp.vec3(numbers[at + X + k], numbers[at + Y + k], numbers[at + Z + k])
        exact = boundary_winding(boundary, tree, 0, wp.vec3d(v))
        found[i, k, 0] = wp.abs(wp.float64(share_at(field, v - p) + numbers[at + SHARE + k]) - exact)
        found[i, k, 1] = wp.float64(doubt(field) + numbers[at + ERROR + k])


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize(
    "mesh",
    [boxes(1), sheets(12), boxes(12), loose(torus(100), 0.01), turned(torus(150), 0.5)],
    ids=["box", "sheets", "boxes", "loose", "turned"],
)
def test_handed_shares_are_right_within_their_errors(mesh, tolerance):
    vertices, faces = mesh
    structure = build(torch.from_numpy(vertices)[None], torch.from_numpy(faces))
    tree, winding = structure.view[:2]
    boundary = winding.boundary
    scale = float(tree.frame.numpy()[SCALE])
    rng = np.random.default_rng(0)
    count = 200
    low, high = vertices.min(0), vertices.max(0)
    radius = 10.0 ** rng.uniform(-2.5, -0.5, (count, 1))
    centres = scale * (low + (high - low) * rng.uniform(-0.3, 1.3, (count, 3)))
    parts = rng.normal(size=(count, 3))
    parts *= rng.uniform(0, 0.6, (count, 1)) / np.linalg.norm(parts, axis=1, keepdims=True)
    ways = rng.normal(size=(count, SIXTEEN, 3))
    ways *= rng.uniform(0, 0.999, (count, SIXTEEN, 1)) / np.linalg.norm(ways, axis=2, keepdims=True)
    # Some at the very end of the part that is furthest from the centre.
    ways[:, 0] = 0.999 * parts / np.linalg.norm(parts, axis=1, keepdims=True)
    blocks = -(-boundary.count // SIXTEEN)
    rows, packed = wp.zeros(ROW * blocks, dtype=wp.float32, device="cpu"), wp.zeros(1, dtype=int, device="cpu")
    wp.launch(pack_edges, 1, inputs=[0, boundary, blocks, rows, packed], device="cpu")
    found = wp.zeros((count, SIXTEEN, 2), dtype=wp.float64, device="cpu")
    given = [
        rows,
        int(packed.numpy()[0]),
        wp.zeros(count * PLACES, dtype=wp.float32, device="cpu"),
        wp.zeros(count * KEPT, dtype=wp.float32, device="cpu"),
        wp.array(np.hstack([centres, radius]).astype(np.float32), dtype=wp.vec4, device="cpu"),
        wp.array(parts.astype(np.float32), dtype=wp.vec3, device="cpu"),
        wp.array(ways.astype(np.float32), dtype=wp.vec3, device="cpu"),
        tolerance,
        wp.zeros((count, LARGE_STACK_ON_CPU), dtype=int, device="cpu"),
    ]
    wp.launch(_hand_down, count, inputs=[tree, boundary, *given, found], device="cpu")
    off, error = np.moveaxis(found.numpy(), 2, 0)
    known = np.isfinite(error)
    assert known.mean() > 0.95
    # With room for the sums' own rounding.
    off = np.maximum(off - 1e-6, 0)
    assert (off <= error)[known].all(), (off - error)[known].max()
    if len(faces) == 10 and tolerance == 1e-4:
        # Of one rim the bounds are not sums of many that cancel: a wrong term of the second order comes to more.
        assert np.quantile((off / error)[known], 0.995) < 0.05
    assert np.median(error[known]) < 4.0 * tolerance + 1e-3
