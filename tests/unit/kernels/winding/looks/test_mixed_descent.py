"""Solid angles of caps from a ball, by its field, nodes and single caps, are right within their errors."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from sdm.engine.acceleration import build
from sdm.kernels.bvh.tree import SCALE, tree_of
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.cap_field import doubt, share_at
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.looks.mixed_descent import END, NODES, ROOM, Looked, look_closer
from sdm.kernels.winding.looks.near_pair import near_pair
from sdm.kernels.winding.looks.node_sum import node_sum
from sdm.kernels.winding.near_caps import FULL
from tests.helpers.winding.cap_balls import MESHES, balls_among, exact_shares


@wp.kernel(enable_backward=False)
def _shares(
    caps: Caps,
    balls: wp.array(dtype=wp.vec4),
    points: wp.array2d(dtype=wp.vec3),
    tolerance: float,
    room: int,
    stacks: wp.array(dtype=int),
    found: wp.array3d(dtype=wp.float64),
    listed: wp.array2d(dtype=int),
    around: wp.array(dtype=wp.vec4),
    nodes: wp.array(dtype=int),
):
    i = wp.tid()
    stack = large_stack_of(stacks, i)
    c = wp.vec3(balls[i][0], balls[i][1], balls[i][2])
    # With balls around, from what is near those.
    begin = Looked()
    middle = wp.vec3()
    handed = wp.int32(-1)
    if around.shape[0] > 0:
        middle = wp.vec3(around[i][0], around[i][1], around[i][2])
        begin = look_closer(caps, 0, middle, around[i][3], tolerance, ROOM, nodes, 0, -1, True, True, stack, 0, 1)
        if begin.field.error < wp.inf:
            handed = begin.nodes
        for k in range(begin.nodes):
            nodes[i * ROOM + k] = stack[NODES + k]
    if handed < 0:
        begin = Looked()
    seen = look_closer(caps, 0, c, balls[i][3], tolerance, room, nodes, i * ROOM, handed, False, False, stack, 0, 1)
    listed[i, 2] = handed
    listed[i, 0] = seen.nodes
    listed[i, 1] = seen.caps
    base = tree_of(caps.tree, 0).root
    for k in range(0, points.shape[1], 2):
        p = points[i, k]
        q = points[i, k + 1]
        near = near_pair(caps.tree.corners, seen.caps, p, q, stack, END - seen.caps)
        first = node_sum(caps.moments, base, stack, NODES, seen.nodes, p, 0, 1) + near[0]
        second = node_sum(caps.moments, base, stack, NODES, seen.nodes, q, 0, 1) + near[2]
        found[i, k, 0] = wp.float64(share_at(seen.field, p - c) + share_at(begin.field, p - middle) + first / FULL)
        found[i, k + 1, 0] = wp.float64(share_at(seen.field, q - c) + share_at(begin.field, q - middle) + second / FULL)
        found[i, k, 1] = wp.float64(doubt(seen.field) + doubt(begin.field) + near[1] / FULL)
        found[i, k + 1, 1] = wp.float64(doubt(seen.field) + doubt(begin.field) + near[3] / FULL)


@pytest.mark.parametrize("handed_down", [False, True])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 3e-7])
@pytest.mark.parametrize("name", MESHES)
def test_within_the_error(name, tolerance, handed_down):
    vertices, faces = MESHES[name]()
    structure = build(torch.tensor(vertices)[None], torch.tensor(faces))
    tree, winding = structure.view[:2]
    caps = winding.caps
    scale = float(tree.frame.numpy()[SCALE])
    corners = caps.tree.corners.numpy().reshape(-1, 4, 3)[:, :3]
    rng = np.random.default_rng(3)
    count, voxels = 300, 8
    low, high = scale * vertices.min(0), scale * vertices.max(0)
    centres, radius, points = balls_among(corners, low, high, count, voxels, rng)
    centres = centres.astype(np.float32)
    stacks = wp.zeros(count * LARGE_STACK_ON_CPU, dtype=int, device="cpu")
    found = wp.zeros((count, voxels, 2), dtype=wp.float64, device="cpu")
    listed = wp.zeros((count, 3), dtype=int, device="cpu")
    balls = wp.array(np.c_[centres, 1.0001 * radius].astype(np.float32), dtype=wp.vec4, device="cpu")
    given = wp.array(points, dtype=wp.vec3, device="cpu")
    # Larger ones, about other points.
    larger = np.c_[centres + radius[:, None] * rng.uniform(-1, 1, (count, 3)), 3.0 * radius][: count * handed_down]
    around = wp.array(larger.astype(np.float32), dtype=wp.vec4, device="cpu")
    nodes = wp.zeros(count * ROOM, dtype=int, device="cpu")
    inputs = [caps, balls, given, tolerance * FULL, ROOM, stacks, found, listed, around, nodes]
    wp.launch(_shares, count, inputs, device="cpu")
    share, error = np.moveaxis(found.numpy(), 2, 0)
    known = np.isfinite(error)
    truth = exact_shares(corners, points.reshape(-1, 3)).reshape(count, voxels)
    assert known.mean() > 0.5
    # As `is_sure` has it, what float32 adds in the end.
    assert (np.abs(share - truth) <= error + 2e-6 + 1e-6 * np.abs(truth))[known].all()
    # What float32 leaves however small the tolerance is.
    assert np.median(error[known]) < 300 * tolerance + 5e-4
    assert listed.numpy()[:, 0].max() > 0
    assert (listed.numpy()[:, 2].max() > 0) == handed_down


def test_nothing_is_known_without_room():
    vertices, faces = MESHES["torn"]()
    structure = build(torch.tensor(vertices)[None], torch.tensor(faces))
    caps = structure.view[1].caps
    corner = caps.tree.corners.numpy()[0]
    balls = wp.array(np.array([[*corner, 0.01]], np.float32), dtype=wp.vec4, device="cpu")
    points = wp.array(corner.reshape(1, 1, 3).repeat(2, 1) + np.float32(1e-3), dtype=wp.vec3, device="cpu")
    stacks = wp.zeros(LARGE_STACK_ON_CPU, dtype=int, device="cpu")
    found, listed = wp.zeros((1, 2, 2), dtype=wp.float64, device="cpu"), wp.zeros((1, 3), dtype=int, device="cpu")
    around, nodes = wp.zeros(0, dtype=wp.vec4, device="cpu"), wp.zeros(ROOM, dtype=int, device="cpu")
    inputs = [caps, balls, points, 1e-7, 5, stacks, found, listed, around, nodes]
    wp.launch(_shares, 1, inputs, device="cpu")
    assert np.isinf(found.numpy()[0, :, 1]).all()
    assert (listed.numpy()[:, :2] == 0).all()
