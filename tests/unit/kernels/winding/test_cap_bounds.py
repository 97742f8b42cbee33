"""Promises of `cap_field` and `hole_caps`: shares are as right as they say, and a box that is far is far."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import torch
import warp as wp

from sdm.bench.common.meshes import sphere
from sdm.engine.acceleration import build
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.cap_descent import see_caps
from sdm.kernels.winding.cap_field import Field, doubt, moved_field, share_at
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.hole_caps import is_far, view_caps
from sdm.kernels.winding.near_caps import FULL, NEAR_LIST, corners_from, near_cap
from tests.helpers import oracle

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _field(
    caps: Caps,
    at: wp.array(dtype=wp.vec3),
    radius: wp.array(dtype=float),
    off: wp.array2d(dtype=wp.vec3),
    tolerance: float,
    room: int,
    way: wp.array(dtype=wp.vec3),
    stacks: wp.array(dtype=wp.int32),
    share: wp.array2d(dtype=float),
    error: wp.array2d(dtype=float),
):
    i = wp.tid()
    stack = large_stack_of(stacks, 0)
    field = Field()
    handed = -1
    if wp.length(way[i]) > 0.0:
        # What a larger ball has found, whose centre is elsewhere.
        centre = at[i] - way[i]
        reach = 1.00001 * (wp.length(at[i] - centre) + radius[i])
        whole = see_caps(caps, 0, centre, reach, tolerance, room, field, handed, True, True, 0, stack, 0, 1, 1, False)
        if whole.error < wp.inf:
            field = moved_field(whole, at[i] - centre)
            handed = whole.near
    field = see_caps(caps, 0, at[i], radius[i], tolerance, room, field, handed, False, True, 0, stack, 0, 1, 1, False)
    for k in range(off.shape[1]):
        near = 0.0 * radius[i]
        wrong = 0.0 * radius[i]
        for n in range(field.near):
            a, b, c = corners_from(caps, stack[NEAR_LIST + n], at[i] + off[i, k])
            angle, room_of_one = near_cap(a, b, c)
            near += angle / FULL
            wrong += room_of_one / FULL
        share[i, k] = share_at(field, (at[i] + off[i, k]) - at[i]) + near
        error[i, k] = doubt(field) + wrong


@wp.kernel
def _view(
    caps: Caps,
    boundary: Boundary,
    at: wp.array(dtype=wp.vec3),
    half: wp.array(dtype=wp.vec3),
    far: wp.array(dtype=float),
    share: wp.array(dtype=float),
    error: wp.array(dtype=float),
):
    i = wp.tid()
    cell = VoxelBox()
    cell.centre = at[i]
    cell.half = half[i]
    cell.half2 = wp.dot(half[i], half[i])
    view = view_caps(caps, boundary, 0, cell, 0, 1)
    far[i] = wp.where(is_far(view), 1.0, 0.0)
    share[i] = view.share
    error[i] = view.error


def fan(rng: np.random.Generator, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """A disc of triangles: round and flat, ragged, or as thin as a needle."""
    count = 24
    turn = 2 * np.pi * np.arange(count) / count
    rim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1) * 0.9
    if kind == "ragged":
        rim *= rng.uniform(0.2, 1.1, (count, 1))
        rim[:, 2] = 0.4 * rng.normal(size=count)
    if kind == "needle":
        rim[:, 1:] *= 1e-4
    faces = [[count, i, (i + 1) % count] for i in range(count)]
    return np.concatenate([rim, [[0.0, 0.0, 0.3]]]).astype(np.float32), np.array(faces, np.int32)


def torn(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A sphere without a tenth of its faces."""
    vertices, faces = sphere(24)
    return vertices, faces[rng.random(len(faces)) >= 0.1]


def caps_of(vertices: np.ndarray, faces: np.ndarray):
    structure = build(torch.from_numpy(vertices)[None], torch.from_numpy(faces))
    return structure, structure.view.winding


def exact_share(caps: Caps, at: np.ndarray) -> np.ndarray:
    corners = caps.tree.corners.numpy().astype(np.float64).reshape(-1, 4, 3)[:, :3]
    corners = corners[(corners[:, 0] != corners[:, 1]).any(1) & (corners[:, 2] != corners[:, 0]).any(1)]
    return oracle.winding_number(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), at)


def places(rng: np.random.Generator, caps: Caps, count: int) -> np.ndarray:
    """Anywhere, near the rim, near the caps, and in their planes, at all distances."""
    triangles = caps.tree.corners.numpy().reshape(-1, 4, 3)[:, :3]
    weight = rng.dirichlet([1, 1, 1], count)
    weight[: count // 2, 2] = 0
    weight /= weight.sum(1, keepdims=True)
    corners = triangles[rng.integers(len(triangles), size=count)]
    away = rng.normal(size=(count, 3)) * 10 ** rng.uniform(-7, 0.5, (count, 1))
    away[::5, 2] = 0
    return ((corners * weight[..., None]).sum(1) + away).astype(np.float32)


@cache
def boxes_about(kind: str):
    """Caps, boxes of all sizes, points among them, places in each, and the exact share there."""
    rng = np.random.default_rng(3)
    structure, winding = caps_of(*(torn(rng) if kind == "torn" else fan(rng, kind)))
    caps = winding.caps
    at = places(rng, caps, 1500)
    half = (10 ** rng.uniform(-5, -0.3, (len(at), 1)) * rng.uniform(0.2, 1, (len(at), 3))).astype(np.float32)
    half[::4] = 0
    off = np.clip(rng.normal(size=(len(at), 9, 3)) * 2, -1, 1).astype(np.float32) * half[:, None]
    # As far as float32 sees it.
    off = (at[:, None] + off) - at[:, None]
    exact = exact_share(caps, (at[:, None] + off).reshape(-1, 3)).reshape(off.shape[:2])
    return structure, caps, at, off, exact


@pytest.mark.parametrize("kind", ["flat", "ragged", "needle", "torn"])
@pytest.mark.parametrize("room", [0, 8, 256])
@pytest.mark.parametrize("tolerance", [0.02, 1e-4])
@pytest.mark.parametrize("handed", [False, True])
def test_a_field_is_as_right_as_it_says(kind, room, tolerance, handed):
    """Of caps that are few, thin, or many; by a descent from the root, or from what a larger ball has found."""
    _structure, caps, at, off, exact = boxes_about(kind)
    radius = (np.linalg.norm(np.abs(off).max(1), axis=1) * 1.000001).astype(np.float32)
    share, error = (wp.zeros(off.shape[:2], dtype=float, device="cpu") for _ in range(2))
    arrays = [wp.array(v, dtype=t, device="cpu") for v, t in ((at, wp.vec3), (radius, float), (off, wp.vec3))]
    rng = np.random.default_rng(6)
    way = rng.normal(size=at.shape) * (np.maximum(radius, 1e-6) * 10 ** rng.uniform(-2, 1, len(at)))[:, None] * handed
    way = wp.array(way.astype(np.float32), dtype=wp.vec3, device="cpu")
    stacks = wp.zeros(LARGE_STACK_ON_CPU, dtype=wp.int32, device="cpu")
    inputs = [caps, *arrays, tolerance, room, way, stacks, share, error]
    wp.launch(_field, len(at), inputs, device="cpu")
    error = error.numpy().astype(np.float64)
    wrong = np.abs(share.numpy() - exact)
    known = np.isfinite(error)
    assert (wrong[known] <= error[known] + 1e-6).all()
    assert (error < 5e-2).mean() > 0.05
    # The bound is not idle: at some places much of it is used.
    assert (wrong[known] / (error[known] + 1e-6)).max() > 0.001


@pytest.mark.parametrize("kind", ["flat", "ragged", "needle"])
def test_a_box_that_is_far_is_far_everywhere(kind):
    rng = np.random.default_rng(4)
    _tensors, winding = caps_of(*fan(rng, kind))
    caps = winding.caps
    centre = places(rng, caps, 4000)
    half = (10 ** rng.uniform(-5, -0.3, (len(centre), 1)) * rng.uniform(0.2, 1, (len(centre), 3))).astype(np.float32)
    seen = [wp.zeros(len(centre), dtype=float, device="cpu") for _ in range(3)]
    boxes = [wp.array(v, dtype=wp.vec3, device="cpu") for v in (centre, half)]
    wp.launch(_view, len(centre), [caps, winding.boundary, *boxes, *seen], device="cpu")
    far, share, error = (values.numpy() for values in seen)
    far = far > 0
    largest, off = np.zeros(len(centre)), np.zeros(len(centre))
    for _ in range(20):
        # Corners and faces of the box more often than its inside.
        offset = np.clip(rng.normal(size=half.shape) * 2, -1, 1) * half
        here = exact_share(caps, centre + offset)
        largest, off = np.maximum(largest, np.abs(here)), np.maximum(off, np.abs(here - share))
    known = np.isfinite(error)
    assert (off[known] <= error[known] + 2e-6).all()
    assert (off[known] / (error[known] + 2e-6)).max() > (0.0003 if kind == "needle" else 0.2)
    assert far.any()
    assert not far.all()
    assert (largest[far] < 0.25).all()
    # Few boxes are taken for near that are not: else nothing is gained.
    small = half.max(1) < 0.02
    assert far[small & (largest < 0.2)].mean() > (0.2 if kind == "needle" else 0.8)
