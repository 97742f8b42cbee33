"""The witness bound: no point that is dropped is nearer to any voxel of the cell, and boxes are tested exactly."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false, reportOperatorIssue=false

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import warp as wp

from sdm.kernels.culling.witness_bound import Witness, box_is_farther, doubt, triangle_is_farther
from sdm.kernels.geometry.voxel_box import VoxelBox

wp.set_module_options({"enable_backward": False})


@wp.func
def _cell(centre: wp.vec3, half: wp.vec3):
    cell = VoxelBox()
    cell.centre = centre
    cell.half = half
    cell.half2 = wp.dot(half, half)
    cell.diagonal = 2.0
    return cell


@wp.func
def _witness(centre: wp.vec3, y: wp.vec3):
    known = Witness()
    known.to_surface = centre - y
    known.distance2 = wp.dot(known.to_surface, known.to_surface)
    return known


@wp.kernel
def _test(
    centre: wp.array(dtype=wp.vec3),
    half: wp.array(dtype=wp.vec3),
    y: wp.array(dtype=wp.vec3),
    corners: wp.array2d(dtype=wp.vec3),
    out: wp.array2d(dtype=float),
):
    i = wp.tid()
    cell = _cell(centre[i], half[i])
    known = _witness(centre[i], y[i])
    a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
    out[i, 0] = wp.where(triangle_is_farther(cell, known, a, b, c), 1.0, 0.0)
    out[i, 1] = wp.where(box_is_farther(cell, known, wp.min(a, wp.min(b, c)), wp.max(a, wp.max(b, c))), 1.0, 0.0)
    out[i, 2] = doubt(cell, known)


def dropped(centre: np.ndarray, half: np.ndarray, y: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Flags of triangles (N,3,3) and boxes that are dropped, and the allowance for rounding: (N,3)."""
    out = wp.zeros((len(centre), 3), dtype=float, device="cpu")
    vectors = [wp.array(np.ascontiguousarray(v, np.float32), dtype=wp.vec3, device="cpu") for v in (centre, half, y)]
    triangles = wp.array(np.ascontiguousarray(corners, np.float32), dtype=wp.vec3, ndim=2, device="cpu")
    wp.launch(_test, len(centre), [*vectors, triangles, out], device="cpu")
    return out.numpy()


def cases(seed: int, count: int, size: float) -> tuple[np.ndarray, ...]:
    """Cells, witnesses about as far as the triangles, and triangles of about this size, float32 numbers in float64."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-0.5, 0.5, (count, 3))
    half = 0.05 * rng.uniform(0.2, 1, (count, 3))
    far = rng.uniform(0.02, 0.6, (count, 1))
    side = rng.normal(size=(count, 3))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = side + 0.3 * rng.normal(size=(count, 3))
    other *= (1 + 0.3 * rng.uniform(0, 1, (count, 1))) / np.linalg.norm(other, axis=1, keepdims=True)
    y = centre + far * side
    corners = (centre + far * other)[:, None] + size * rng.normal(size=(count, 3, 3))
    return tuple(v.astype(np.float32).astype(np.float64) for v in (centre, half, y, corners))


@pytest.mark.parametrize("size", [0.0, 1e-3, 2e-2, 0.2])
def test_no_nearer_triangle_is_dropped(size):
    """Of many points of each triangle none is nearer to a corner of the cell than the witness, if it is dropped."""
    centre, half, y, corners = cases(1, 20_000, size)
    gone = dropped(centre, half, y, corners)[:, 0] > 0
    weights = np.array([w for w in product(np.linspace(0, 1, 9), repeat=3) if abs(sum(w) - 1) < 1e-9])
    least = np.full(len(centre), np.inf)
    for signs in product((-1, 1), repeat=3):
        p = centre + half * signs
        for w in weights:
            x = np.einsum("j,njk->nk", w, corners)
            least = np.minimum(least, ((p - x) ** 2).sum(1) - ((p - y) ** 2).sum(1))
    assert (least[gone] > 0).all()
    # And those that are beaten by far are dropped: the test is not idle.
    beaten = least > 1e-4 + 0.4 * size**2 * 25
    assert gone[beaten].mean() > (0.99 if size < 0.1 else 0.0)
    assert 0.05 < gone.mean() < 0.95 or size > 0.1


def test_boxes_exactly():
    """A box is dropped just where no point of it is nearer to any point of the cell, but for rounding."""
    centre, half, y, corners = cases(2, 20_000, 1e-2)
    found = dropped(centre, half, y, corners)
    low, high = corners.min(1), corners.max(1)
    lead = np.zeros(len(centre))
    for axis in range(3):
        # The least of (p - x)^2 - (p - y)^2 over a fine choice of p: of a concave function it is at an end.
        p = centre[:, axis, None] + half[:, axis, None] * np.linspace(-1, 1, 65)
        e = np.maximum(np.maximum(low[:, axis, None] - p, p - high[:, axis, None]), 0)
        lead += (e**2 - (p - y[:, axis, None]) ** 2).min(1)
    gone, room = found[:, 1] > 0, found[:, 2]
    assert not gone[lead <= 0].any()
    assert gone[lead > 2 * room].all()
    assert 0.1 < gone.mean() < 0.9


def test_without_a_witness_nothing_is_dropped():
    centre, half, y, corners = cases(3, 100, 1e-2)
    y[:50] = np.inf
    y[50:] = 3e19
    assert not dropped(centre, half, y, corners)[:, :2].any()
