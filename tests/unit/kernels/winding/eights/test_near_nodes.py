"""Solid angles of caps at the voxels of a box, by its field and by nodes and caps added to eight voxels, are right
within their errors.
"""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from sdm.bench.common.dirty_meshes.by_code import boxes, half_spheres, loose, torn, turned
from sdm.bench.common.meshes import torus
from sdm.engine.acceleration import build
from sdm.kernels.bvh.tree import SCALE, tree_of
from sdm.kernels.winding.cap_field import Field, doubt, share_at
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE, Caps
from sdm.kernels.winding.eight_voxels import Eight
from sdm.kernels.winding.eights.boxes_by_caps import with_seen
from sdm.kernels.winding.eights.near_nodes import see_nodes
from sdm.kernels.winding.eights.node_angles import angles_of_nodes
from sdm.kernels.winding.eights.node_table import (
    HAND_DOWN,
    HANDED,
    LISTED,
    MIXED,
    ROW,
    STACK,
    TO_VOXELS,
    pack_nodes,
)
from tests.helpers.winding.cap_balls import exact_shares

_HAND_DOWN, _HANDED, _LISTED = (wp.constant(number) for number in (HAND_DOWN, HANDED, LISTED))
FULL = 4 * np.pi


@wp.kernel(enable_backward=False)
def _shares(
    caps: Caps,
    rows: wp.array(dtype=wp.float32),
    balls: wp.array(dtype=wp.vec4),
    points: wp.array2d(dtype=wp.vec3),
    tolerance: float,
    mode: int,
    handed_down: int,
    stacks: wp.array(dtype=int),
    found: wp.array3d(dtype=wp.float64),
):
    i = wp.tid()
    at = i * STACK
    c = wp.vec3(balls[i][0], balls[i][1], balls[i][2])
    radius = balls[i][3]
    one = tree_of(caps.tree, 0)
    leaves = 1 << one.depth
    handed = int(-1)  # noqa: RUF046, UP018
    field = Field()
    if handed_down != 0:
        field = with_seen(
            field,
            see_nodes(
                caps.moments, rows, one.root, leaves, stacks, at, -1, c, 2.0 * radius, tolerance, _HAND_DOWN, _HANDED
            ),
        )
        handed = field.near
    field = with_seen(
        field,
        see_nodes(caps.moments, rows, one.root, leaves, stacks, at, handed, c, radius, tolerance, mode, _LISTED),
    )
    xs, ys, zs = Eight(), Eight(), Eight()
    for k in range(8):
        xs[k] = points[i, k][0]
        ys[k] = points[i, k][1]
        zs[k] = points[i, k][2]
    angles = angles_of_nodes(
        caps.moments, rows, one.root, leaves, caps.tree.corners, one.first, one.count, one.depth, stacks, at,
        field.near, c, radius, tolerance, xs, ys, zs,
    )  # fmt: skip
    for k in range(8):
        found[i, k, 0] = wp.float64(share_at(field, points[i, k] - c) + angles[k] / FULL)
        found[i, k, 1] = wp.float64(doubt(field) + angles[8 + k] / FULL)


@pytest.mark.parametrize("mode", [MIXED, TO_VOXELS])
@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-5])
@pytest.mark.parametrize(
    "mesh",
    [torn(torus(2000), 0.3), turned(torus(2000), 0.5), half_spheres(6), boxes(12), loose(torus(300), 0.01)],
    ids=["torn", "turned", "half spheres", "boxes", "loose"],
)
def test_shares_are_right_within_their_errors(mesh, tolerance, mode):
    vertices, faces = mesh
    structure = build(torch.from_numpy(vertices)[None], torch.from_numpy(faces))
    tree, winding = structure.view[:2]
    caps = winding.caps
    scale = float(tree.frame.numpy()[SCALE])
    rng = np.random.default_rng(0)
    count = 200
    low, high = vertices.min(0), vertices.max(0)
    radius = 10.0 ** rng.uniform(-3, -0.7, (count, 1))
    centres = scale * (low + (high - low) * rng.uniform(-0.2, 1.2, (count, 3)))
    corners = caps.tree.corners.numpy().reshape(-1, 4, 3)[:, :3].astype(np.float64)
    # Some near caps.
    middle = corners.mean(1)
    near = rng.integers(len(corners), size=count // 2)
    centres[: count // 2] = middle[near] + radius[: count // 2] * rng.normal(size=(count // 2, 3))
    ways = rng.normal(size=(count, 8, 3))
    ways *= rng.uniform(0, 0.999, (count, 8, 1)) / np.linalg.norm(ways, axis=2, keepdims=True)
    balls = np.hstack([centres, radius]).astype(np.float32)
    points = (balls[:, None, :3] + balls[:, None, 3:] * ways).astype(np.float32)
    nodes = caps.moments.size // MOMENTS_SIZE
    rows = wp.zeros(ROW * nodes, dtype=wp.float32, device="cpu")
    wp.launch(pack_nodes, nodes, inputs=[0, caps.moments, rows], device="cpu")
    exact = exact_shares(corners, points.reshape(-1, 3)).reshape(count, 8)
    for handed_down in (0, 1):
        found = wp.zeros((count, 8, 2), dtype=wp.float64, device="cpu")
        given = [wp.array(balls, dtype=wp.vec4, device="cpu"), wp.array(points, dtype=wp.vec3, device="cpu")]
        stacks = wp.zeros(count * STACK, dtype=int, device="cpu")
        inputs = [caps, rows, *given, tolerance, mode, handed_down, stacks, found]
        wp.launch(_shares, count, inputs=inputs, device="cpu")
        values, error = np.moveaxis(found.numpy(), 2, 0)
        known = np.isfinite(error)
        assert known.mean() > 0.9
        off = np.abs(values - exact)
        # With room for the sums' own rounding.
        assert (off <= error + 2e-6)[known].all(), (off - error)[known].max()
        assert np.median(error[known]) < 20 * tolerance + 1e-3
