"""The brute force against exact rational arithmetic, on the thinnest triangles that float32 can hold."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from tests.helpers.oracle import distance


def exact_distance(corner, point):
    """Distance of one point from one triangle with no rounding before the last square root."""
    p, a, b, c = ([Fraction(float(x)) for x in v] for v in (point, *corner))
    squares = [_segment(p, a, b), _segment(p, b, c), _segment(p, c, a)]
    normal = _cross(_minus(b, a), _minus(c, a))
    area = _dot(normal, normal)
    if area and all(
        _dot(_cross(normal, _minus(end, start)), _minus(p, start)) >= 0 for start, end in ((a, b), (b, c), (c, a))
    ):
        squares.append(_dot(normal, _minus(p, a)) ** 2 / area)
    return _root(min(squares))


def _segment(p, a, b):
    edge, to_point = _minus(b, a), _minus(p, a)
    squared = _dot(edge, edge)
    along = min(max(_dot(to_point, edge) / squared, Fraction(0)), Fraction(1)) if squared else Fraction(0)
    rest = [q - along * e for q, e in zip(to_point, edge, strict=True)]
    return _dot(rest, rest)


def _root(square):
    # Scaled to whole numbers first: a fraction may be too small or too large for a float.
    return float(Fraction(_isqrt(square.numerator * square.denominator << 200), square.denominator << 100))


def _isqrt(n):
    import math

    return math.isqrt(n)


def _minus(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def _dot(a, b):
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def _cross(a, b):
    return [a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3] for i in range(3)]


def slivers(rng, thickness, scale, offset):
    """Random triangles whose third corner is `thickness` of their length off the line of the others."""
    a, b = rng.normal(size=(2, 3))
    corner = np.stack([a, b, a + rng.uniform(-0.2, 1.2) * (b - a) + thickness * rng.normal(size=3)])
    return (scale * (rng.permutation(corner) + offset)).astype(np.float32).astype(np.float64)


@pytest.mark.parametrize("thickness", [1.0, 1e-3, 1e-5, 1e-6, 1e-7, 1e-9, 0.0])
@pytest.mark.parametrize(("scale", "offset"), [(1, 0), (1e20, 0), (1e-20, 0), (1, 1e4)])
def test_equals_rational_arithmetic(thickness, scale, offset):
    rng = np.random.default_rng(int(1e6 * thickness) + 17)
    for _ in range(12):
        corner = slivers(rng, thickness, scale, offset)
        weights = rng.dirichlet(np.ones(3), 5)
        near = weights @ corner + rng.normal(size=(5, 3)) * scale * 10.0 ** rng.integers(-9, 2, (5, 1))
        points = np.concatenate([near, corner, corner[:1] + 50 * scale * rng.normal(size=(2, 3))])
        points = points.astype(np.float32).astype(np.float64)
        d, _, _ = distance(corner, np.array([[0, 1, 2]]), points)
        expected = [exact_distance(corner, p) for p in points]
        size = max(np.abs(corner).max(), np.abs(points).max())
        np.testing.assert_allclose(d, expected, rtol=0, atol=2e-14 * size)


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_corners_a_few_roundings_off_a_line(steps):
    """Corners on neighbouring float32 numbers: relative areas down to 1e-14, where normals have no digits left."""
    rng = np.random.default_rng(steps)
    for _ in range(12):
        a, b = rng.normal(size=(2, 3)).astype(np.float32)
        c = (a + np.float32(rng.uniform()) * (b - a)).astype(np.float32)
        for _ in range(steps):
            c = np.nextafter(c, rng.normal(size=3).astype(np.float32))
        corner = np.stack([a, b, c]).astype(np.float64)
        points = np.concatenate([rng.normal(size=(6, 3)), corner + 1e-6 * rng.normal(size=(3, 3))])
        points = points.astype(np.float32).astype(np.float64)
        d, _, _ = distance(corner, np.array([[0, 1, 2]]), points)
        np.testing.assert_allclose(d, [exact_distance(corner, p) for p in points], rtol=0, atol=1e-13)
