"""Sums of all caps' solid angles in float32 are those of float64, within their bound, which is small for small caps."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from sdm.kernels.winding.all_caps import cap_sum
from sdm.kernels.winding.near_caps import FULL, NEAR_LIST, near_sum
from tests.helpers.winding.cap_balls import exact_shares


@wp.kernel(enable_backward=False)
def _sums(
    corners: wp.array(dtype=wp.vec3),
    count: int,
    points: wp.array(dtype=wp.vec3),
    listed: wp.array(dtype=wp.int32),
    alone: wp.array(dtype=wp.vec2),
    product: wp.array(dtype=wp.vec2),
):
    i = wp.tid()
    alone[i] = cap_sum(corners, 0, count, points[i], 0, 1)
    product[i] = near_sum(corners, count, True, points[i], listed, NEAR_LIST, 0, 1, 1) / FULL


@pytest.mark.parametrize("size", [1e-3, 0.02, 0.3, 3.0])
def test_within_the_bound(size):
    rng = np.random.default_rng(int(1e3 * size))
    count = 3000
    corners = rng.uniform(-1, 1, (count, 1, 3)) + size * rng.normal(size=(count, 4, 3))
    corners[:10, 2] = corners[:10, 1]
    corners[10:40, 2] = corners[10:40, 1] + 1e-3 * (corners[10:40, 1] - corners[10:40, 0])
    corners = corners.astype(np.float32)
    points = rng.uniform(-1, 1, (400, 3)).astype(np.float32)
    # Beside corners, edges and faces.
    for n, weights in enumerate(([1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0.2, 0.3, 0.5])):
        near = (np.array(weights)[:, None] * corners[100 + 20 * n : 120 + 20 * n, :3]).sum(1)
        points[20 * n : 20 * n + 20] = near + size * 10.0 ** rng.uniform(-5, 0, (20, 1)) * rng.normal(size=(20, 3))
    points[0] = corners[200, 0]
    alone, product = (wp.zeros(len(points), dtype=wp.vec2, device="cpu") for _ in range(2))
    listed = np.zeros(NEAR_LIST + count, np.int32)
    listed[NEAR_LIST:] = 4 * np.arange(count)
    given = wp.array(corners.reshape(-1, 3), dtype=wp.vec3, device="cpu")
    inputs = [
        given,
        count,
        wp.array(points, dtype=wp.vec3, device="cpu"),
        wp.array(listed, device="cpu"),
    ]
    wp.launch(_sums, len(points), [*inputs, alone, product], device="cpu")
    truth = exact_shares(corners[:, :3], points)
    for found in (alone.numpy(), product.numpy()):
        share, error = found.T
        known = np.isfinite(error)
        assert not known[0]
        assert known[100:].mean() > 0.99
        assert (np.abs(share - truth)[known] <= error[known]).all()
        assert error[known].max() < 1
    assert np.median(alone.numpy()[100:, 1]) < (3e-5 if size < 0.1 else 1e-2)
