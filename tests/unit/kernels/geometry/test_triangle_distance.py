"""Distances to one triangle on the device: the float64 form is exact, the float32 form searches well enough."""
# pyright: reportInvalidTypeForm=false, reportOperatorIssue=false, reportArgumentType=false

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

import sdm.engine.acceleration  # noqa: F401 (starts Warp quietly)
from sdm.kernels.geometry.triangle_distance import closest_point, nearest_part, solid_angle, unit_normal
from tests.helpers import oracle


@wp.kernel(enable_backward=False)
def _measure(
    points: wp.array(dtype=wp.vec3),
    corner: wp.array(dtype=wp.vec3),
    fast: wp.array(dtype=wp.float32),
    exact: wp.array(dtype=wp.float64),
    weights: wp.array(dtype=wp.vec3d),
    angle: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    a = wp.vec3d(corner[3 * i])
    b = wp.vec3d(corner[3 * i + 1])
    c = wp.vec3d(corner[3 * i + 2])
    p = wp.vec3d(points[i])
    n = wp.vec3(unit_normal(a, b, c))
    distance2, _part = nearest_part(points[i], corner[3 * i], corner[3 * i + 1], corner[3 * i + 2], n)
    fast[i] = distance2
    hit = closest_point(p, a, b, c)
    exact[i] = hit.distance2
    weights[i] = hit.barycentric
    angle[i] = solid_angle(a - p, b - p, c - p)


def _triangles(kind: str, count: int, rng: np.random.Generator) -> np.ndarray:
    corner = rng.uniform(-1, 1, (count, 3, 3))
    along = corner[:, 0] + rng.choice([0, 0.5, 1, 1.5], (count, 1)) * (corner[:, 1] - corner[:, 0])
    if kind == "lattice":
        corner = rng.integers(-2, 3, (count, 3, 3)) / 2
    elif kind == "needles":
        corner[:, 2] = along + 10.0 ** rng.uniform(-12, -2, (count, 1)) * rng.normal(size=(count, 3))
    elif kind == "collinear":
        start, step = rng.integers(-8, 8, (2, count, 1, 3)) / 16
        corner = start + rng.integers(0, 3, (count, 3, 1)) * step
    elif kind == "tiny":
        corner = corner[:, :1] + 1e-5 * rng.normal(size=(count, 3, 3))
    return corner.astype(np.float32)


@pytest.mark.parametrize("kind", ["any", "lattice", "needles", "collinear", "tiny"])
def test_against_the_brute_force(kind):
    rng = np.random.default_rng(4)
    count = 4000
    corner = _triangles(kind, count, rng)
    points = rng.uniform(-1, 1, (count, 3))
    on = (rng.dirichlet([1, 1, 1], count)[:, None] @ corner)[:, 0]
    points[::2] = on[::2] + 10.0 ** rng.uniform(-8, 0, (len(points[::2]), 1)) * rng.normal(size=(len(points[::2]), 3))
    points[::5] = np.round(points[::5] * 2) / 2
    points = points.astype(np.float32)

    made = {"fast": wp.float32, "exact": wp.float64, "weights": wp.vec3d, "angle": wp.float64}
    out = [wp.zeros(count, dtype=dtype, device="cpu") for dtype in made.values()]
    given = [wp.array(array, dtype=wp.vec3, device="cpu") for array in (points, corner.reshape(-1, 3))]
    wp.launch(_measure, dim=count, inputs=[*given, *out], device="cpu")
    fast, exact, weights, angle = (array.numpy() for array in out)

    offset = oracle.closest_on_triangles(points.astype(np.float64), corner.astype(np.float64))
    expected = np.linalg.norm(offset, axis=1)
    # Slivers no higher than 2^-26 of their length are measured by their edges, which is half as close.
    flat = 2.0**-27 * np.linalg.norm(corner - corner[:, [1, 2, 0]], axis=2).max(1).clip(1)
    np.testing.assert_array_less(np.abs(np.sqrt(exact) - expected), flat + 4e-10)
    np.testing.assert_allclose(np.sqrt(fast), expected, rtol=0, atol=6 * 2**-24 * 4)
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-14)
    closest = (weights[:, None] @ corner)[:, 0]
    np.testing.assert_array_less(np.abs(np.linalg.norm(points - closest, axis=1) - expected), flat + 4e-10)
    off = expected > 1e-3
    winding = np.array([oracle.winding_number(c, [[0, 1, 2]], p[None])[0] for c, p in zip(corner, points, strict=True)])
    np.testing.assert_allclose(angle[off] / (4 * np.pi), winding[off], rtol=0, atol=1e-8)
