"""A first look's field and near caps of a ball are right within their error, also from what a larger one hands down."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from sdm.engine.acceleration import build
from sdm.kernels.bvh.tree import SCALE
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.cap_descent import most_of
from sdm.kernels.winding.cap_field import Field, doubt, moved_field, share_at
from sdm.kernels.winding.cap_taylor import bound_of_cap, may_be_expanded
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.looks.box_descent import NEAR_AT, see_box
from sdm.kernels.winding.near_caps import FULL, corners_from, near_cap, place_of_cap
from tests.helpers.winding.cap_balls import MESHES, balls_among, exact_shares


@wp.kernel(enable_backward=False)
def _shares(
    caps: Caps,
    balls: wp.array(dtype=wp.vec4),
    around: wp.array(dtype=wp.vec4),
    points: wp.array2d(dtype=wp.vec3),
    tolerance: float,
    room: int,
    stacks: wp.array(dtype=int),
    found: wp.array3d(dtype=wp.float64),
    listed: wp.array2d(dtype=int),
):
    i = wp.tid()
    stack = large_stack_of(stacks, i)
    c = wp.vec3(balls[i][0], balls[i][1], balls[i][2])
    begin = Field()
    handed = wp.int32(-1)
    if around.shape[0] > 0:
        middle = wp.vec3(around[i][0], around[i][1], around[i][2])
        whole = see_box(caps, 0, middle, around[i][3], tolerance, room, begin, -1, True, stack, 0, 1)
        if whole.error < wp.inf:
            begin = moved_field(whole, c - middle)
            handed = whole.near
    seen = see_box(caps, 0, c, balls[i][3], tolerance, room, begin, handed, False, stack, 0, 1)
    listed[i, 0] = handed
    listed[i, 1] = seen.near
    for k in range(points.shape[1]):
        near = wp.float32(0.0)
        wrong = wp.float32(0.0)
        for n in range(seen.near):
            a, b, d = corners_from(caps, stack[NEAR_AT + n], points[i, k])
            angle, error = near_cap(a, b, d)
            near = near + angle
            wrong = wrong + error
        found[i, k, 0] = wp.float64(share_at(seen, points[i, k] - c) + near / FULL)
        found[i, k, 1] = wp.float64(doubt(seen) + wrong / FULL)
        found[i, k, 2] = wp.float64(seen.left_out / FULL)
        found[i, k, 3] = wp.float64(near / FULL)


@pytest.mark.parametrize("handed_down", [False, True])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-4])
@pytest.mark.parametrize("name", MESHES)
def test_within_the_error(name, tolerance, handed_down):
    vertices, faces = MESHES[name]()
    structure = build(torch.tensor(vertices)[None], torch.tensor(faces))
    tree, winding = structure.view[:2]
    caps = winding.caps
    scale = float(tree.frame.numpy()[SCALE])
    corners = caps.tree.corners.numpy().reshape(-1, 4, 3)[:, :3]
    rng = np.random.default_rng(5)
    count, voxels = 200, 6
    low, high = scale * vertices.min(0), scale * vertices.max(0)
    centres, radius, points = balls_among(corners, low, high, count, voxels, rng)
    stacks = wp.zeros(count * LARGE_STACK_ON_CPU, dtype=int, device="cpu")
    found = wp.zeros((count, voxels, 4), dtype=wp.float64, device="cpu")
    listed = wp.zeros((count, 2), dtype=int, device="cpu")
    balls = np.c_[centres, 1.0001 * radius].astype(np.float32)
    larger = np.c_[centres + 0.5 * radius[:, None] * rng.uniform(-1, 1, (count, 3)), 2.0 * radius]
    larger = larger[: count * handed_down].astype(np.float32)
    given = [wp.array(each, dtype=wp.vec4, device="cpu") for each in (balls, larger)]
    places = wp.array(points, dtype=wp.vec3, device="cpu")
    inputs = [caps, *given, places, tolerance * FULL, 320, stacks, found, listed]
    wp.launch(_shares, count, inputs, device="cpu")
    share, error, left_out, near = np.moveaxis(found.numpy(), 2, 0)
    known = np.isfinite(error)
    truth = exact_shares(corners, points.reshape(-1, 3)).reshape(count, voxels)
    assert known.mean() > 0.5
    assert (np.abs(share - truth) <= error + 2e-6 + 1e-6 * np.abs(truth))[known].all()
    # What near caps may add at most.
    assert (np.abs(near) <= 1.0001 * left_out + 1e-6)[known].all()
    assert np.median(error[known]) < 300 * tolerance
    assert listed.numpy()[:, 1].max() > 0
    assert (listed.numpy()[:, 0].max() > 0) == handed_down


@wp.kernel(enable_backward=False)
def _expanded(caps: Caps, at: wp.array(dtype=wp.vec3), radius: wp.array(dtype=float), out: wp.array2d(dtype=float)):
    i = wp.tid()
    leaves = 1 << caps.tree.depth
    place = place_of_cap(caps, 0, i)
    node = caps.tree.root + leaves + i
    centre = wp.vec3(caps.moments[32 * node], caps.moments[32 * node + 1], caps.moments[32 * node + 2])
    r = caps.moments[32 * node + 3]
    for k in range(at.shape[0]):
        a, b, c = corners_from(caps, place, at[k])
        angle, wrong = near_cap(a, b, c)
        bound = bound_of_cap(a, b, c, radius[k], angle, wrong)
        may = wp.float32(0.0)
        if may_be_expanded(r, wp.length(centre - at[k]), radius[k], bound):
            may = 1.0
        # A cap that is not there has no area, and nothing of it is known.
        out[i, k] = wp.where(most_of(caps, node, at[k], radius[k]) > 0.0 and bound < wp.inf, may, 1.0)


@pytest.mark.parametrize("name", MESHES)
def test_no_cap_is_turned_down_whose_polynomial_will_do(name):
    """With its own bound for a tolerance it may be expanded."""
    vertices, faces = MESHES[name]()
    structure = build(torch.tensor(vertices)[None], torch.tensor(faces))
    tree, winding = structure.view[:2]
    caps = winding.caps
    scale = float(tree.frame.numpy()[SCALE])
    rng = np.random.default_rng(7)
    at = rng.uniform(scale * vertices.min(0), scale * vertices.max(0), (40, 3)).astype(np.float32)
    radius = (10.0 ** rng.uniform(-3, -1, 40)).astype(np.float32)
    count = len(caps.tree.face.numpy())
    out = wp.zeros((min(count, 1 << caps.tree.depth), 40), dtype=float, device="cpu")
    given = [wp.array(at, dtype=wp.vec3, device="cpu"), wp.array(radius, dtype=float, device="cpu")]
    wp.launch(_expanded, out.shape[0], [caps, *given, out], device="cpu")
    assert (out.numpy() == 1).all()
