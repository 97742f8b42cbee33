"""Solid angles of near caps from eight voxels at once are those that a lane finds for each, within both errors."""

from __future__ import annotations

import numpy as np
import warp as wp

from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.eight_voxels import Eight, Sixteen, near_angles
from sdm.kernels.winding.near_caps import NEAR_LIST, near_angle


@wp.kernel(enable_backward=False)
def _both(
    caps: Caps,
    near: int,
    points: wp.array(dtype=wp.vec3),
    stack: wp.array(dtype=wp.int32),
    eights: wp.array(dtype=Sixteen),
    alone: wp.array(dtype=wp.vec2),
):
    i = wp.tid()
    xs = Eight()
    ys = Eight()
    zs = Eight()
    for k in range(8):
        p = points[8 * i + k]
        xs[k] = p[0]
        ys[k] = p[1]
        zs[k] = p[2]
        angle, error = near_angle(caps, near, True, p, stack, NEAR_LIST, 0, 1, 1)
        alone[8 * i + k] = wp.vec2(angle, error)
    eights[i] = near_angles(caps.tree.corners, near, xs, ys, zs, stack)


def test_eight_at_once_are_as_each_by_itself():
    rng = np.random.default_rng(3)
    near, groups = 300, 64
    corners = rng.normal(size=(near, 4, 3)).astype(np.float32)
    corners[: near // 2] = corners[: near // 2, :1] + 0.05 * corners[: near // 2]
    # The same side from everywhere, so that whole turns add up; one without an area; a point that is a corner.
    corners[:100, :3] = [[-9, -9, 0], [9, -9, 0], [0, 9, 0]]
    corners[100, 2] = corners[100, 1]
    points = rng.uniform(-1, 1, (8 * groups, 3)).astype(np.float32)
    points[5] = corners[120, 0]
    caps = Caps()
    caps.tree.corners = wp.array(corners.reshape(-1, 3), dtype=wp.vec3, device="cpu")
    stack = np.zeros(LARGE_STACK_ON_CPU, np.int32)
    stack[NEAR_LIST : NEAR_LIST + near] = 4 * rng.permutation(near)
    eights = wp.zeros(groups, dtype=Sixteen, device="cpu")
    alone = wp.zeros(8 * groups, dtype=wp.vec2, device="cpu")
    inputs = [caps, near, wp.array(points, dtype=wp.vec3, device="cpu"), wp.array(stack, device="cpu"), eights, alone]
    wp.launch(_both, groups, inputs, device="cpu")
    angles, errors = eights.numpy().reshape(groups, 2, 8).transpose(1, 0, 2).reshape(2, -1)
    angle, error = alone.numpy().T
    assert np.isinf(errors[5])
    assert (np.isinf(errors) == np.isinf(error)).all()
    known = np.isfinite(error)
    assert known.mean() > 0.9
    assert (np.abs(angles - angle)[known] <= (errors + error)[known]).all()
    assert np.abs(angles[known]).max() > 100
    assert np.median(errors[known]) < 2 * np.median(error[known])
