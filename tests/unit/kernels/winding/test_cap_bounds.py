"""The two promises of `kernels/winding/hole_caps.py`: shares are as right as they say, and a box that is far is far."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from sdm.engine.acceleration import build
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.winding import winding_number
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.hole_caps import doubt, is_far, see_caps, share_of_turn, view_caps

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _see(boundary: Boundary, at: wp.array(dtype=wp.vec3), share: wp.array(dtype=float), error: wp.array(dtype=float)):
    i = wp.tid()
    sight = see_caps(boundary, 0, at[i], 0, 1)
    share[i] = share_of_turn(sight) + float(sight.turns)
    error[i] = doubt(sight)


@wp.kernel
def _view(
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
    view = view_caps(boundary, 0, cell, 0, 1)
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


def caps_of(vertices: np.ndarray, faces: np.ndarray):
    structure = build(torch.from_numpy(vertices)[None], torch.from_numpy(faces))
    assert structure.kind == winding_number.OPEN
    return structure, structure.view.winding.boundary


def exact_share(boundary: Boundary, at: np.ndarray) -> np.ndarray:
    ends = boundary.ends.numpy().astype(np.float64).reshape(-1, 2, 3)
    corners = np.stack([ends[:, 1], ends[:, 0], boundary.apexes.numpy().astype(np.float64)], 1)
    a, b, c = np.moveaxis(corners[None] - at[:, None, None].astype(np.float64), 2, 0)
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    volume = (a * np.cross(b, c)).sum(-1)
    facing = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.arctan2(volume, facing).sum(1) / (2 * np.pi)


def places(rng: np.random.Generator, boundary: Boundary, count: int) -> np.ndarray:
    """Anywhere, near the rim, near the caps, and in their planes, at all distances."""
    ends = boundary.ends.numpy().reshape(-1, 2, 3)
    apexes = boundary.apexes.numpy()
    edge = rng.integers(len(ends), size=count)
    weight = rng.dirichlet([1, 1, 1], count)
    weight[: count // 2, 2] = 0
    weight /= weight.sum(1, keepdims=True)
    corners = np.stack([ends[edge, 0], ends[edge, 1], apexes[edge]], 1)
    away = rng.normal(size=(count, 3)) * 10 ** rng.uniform(-7, 0.5, (count, 1))
    away[::5, 2] = 0
    return ((corners * weight[..., None]).sum(1) + away).astype(np.float32)


@pytest.mark.parametrize("kind", ["flat", "ragged", "needle"])
def test_a_share_in_float32_is_as_right_as_it_says(kind):
    rng = np.random.default_rng(3)
    _tensors, boundary = caps_of(*fan(rng, kind))
    at = places(rng, boundary, 20000)
    share, error = wp.zeros(len(at), dtype=float, device="cpu"), wp.zeros(len(at), dtype=float, device="cpu")
    wp.launch(_see, len(at), [boundary, wp.array(at, dtype=wp.vec3, device="cpu"), share, error], device="cpu")
    share, error = share.numpy().astype(np.float64), error.numpy().astype(np.float64)
    off = np.abs(share - exact_share(boundary, at))
    known = np.isfinite(error)
    assert (off[known] <= error[known] + 1e-6).all()
    assert (error < 1e-3).mean() > (0.2 if kind == "needle" else 0.5)
    # The bound is not idle: at some places much of it is used.
    assert (off[known] / (error[known] + 1e-6)).max() > (0.001 if kind == "needle" else 0.02)


@pytest.mark.parametrize("kind", ["flat", "ragged", "needle"])
def test_a_box_that_is_far_is_far_everywhere(kind):
    rng = np.random.default_rng(4)
    _tensors, boundary = caps_of(*fan(rng, kind))
    centre = places(rng, boundary, 4000)
    half = (10 ** rng.uniform(-5, -0.3, (len(centre), 1)) * rng.uniform(0.2, 1, (len(centre), 3))).astype(np.float32)
    seen = [wp.zeros(len(centre), dtype=float, device="cpu") for _ in range(3)]
    boxes = [wp.array(v, dtype=wp.vec3, device="cpu") for v in (centre, half)]
    wp.launch(_view, len(centre), [boundary, *boxes, *seen], device="cpu")
    far, share, error = (values.numpy() for values in seen)
    far = far > 0
    largest, off = np.zeros(len(centre)), np.zeros(len(centre))
    for _ in range(40):
        # Corners and faces of the box more often than its inside.
        offset = np.clip(rng.normal(size=half.shape) * 2, -1, 1) * half
        here = exact_share(boundary, centre + offset)
        largest, off = np.maximum(largest, np.abs(here)), np.maximum(off, np.abs(here - share))
    known = np.isfinite(error)
    assert (off[known] <= error[known] + 2e-6).all()
    assert (off[known] / (error[known] + 2e-6)).max() > (0.001 if kind == "needle" else 0.2)
    assert far.any()
    assert not far.all()
    assert (largest[far] < 0.25).all()
    # Few boxes are taken for near that are not: else nothing is gained.
    small = half.max(1) < 0.02
    assert far[small & (largest < 0.2)].mean() > (0.2 if kind == "needle" else 0.8)
