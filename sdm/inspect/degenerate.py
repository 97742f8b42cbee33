"""Exact test for zero-area triangles."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from jaxtyping import Bool, Float32

EPSILON = np.finfo(np.float64).eps
SPLITTER = 2.0**27 + 1


def zero_area(corners: Float32[np.ndarray, "F 3 3"]) -> Bool[np.ndarray, " F"]:
    """Mark triangles (F,3,3) float32 whose corners are exactly on one line or point: (F,) bool.

    Exact: float64 decides where its rounding cannot matter, error-free products decide the rest, and rational
    numbers the few whose edges do not even fit into float64. (Dekker 1971; Shewchuk 1997, adaptive predicates.)
    """
    points = corners.astype(np.float64)
    p, q = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    left = p[:, [1, 2, 0]] * q[:, [2, 0, 1]]
    right = p[:, [2, 0, 1]] * q[:, [1, 2, 0]]
    # Each factor carries one rounding, each product one more, and so does the difference.
    doubtful = (np.abs(left - right) <= 8 * EPSILON * (np.abs(left) + np.abs(right))).all(1)
    flat = np.zeros(len(points), dtype=bool)
    index = np.flatnonzero(doubtful)
    if len(index) == 0:
        return flat
    points, p, q = points[index], p[index], q[index]
    exact = _exact_difference(points[:, 1], points[:, 0]) & _exact_difference(points[:, 2], points[:, 0])
    flat[index] = (_same_product(p[:, [1, 2, 0]], q[:, [2, 0, 1]], p[:, [2, 0, 1]], q[:, [1, 2, 0]])).all(1)
    for i in np.flatnonzero(~exact):
        flat[index[i]] = _zero_area_rational(points[i])
    return flat


def _exact_difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Mark the rows whose a - b (n,3) fits into float64 without rounding: (n,) bool."""
    difference = a - b
    part = a - difference
    error = (a - (difference + part)) + (part - b)
    return (error == 0).all(1)


def _same_product(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Compare a*b with c*d exactly: their roundings and the errors of these are equal."""
    return (a * b == c * d) & (_product_error(a, b) == _product_error(c, d))


def _product_error(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    a_high, b_high = _upper_half(a), _upper_half(b)
    a_low, b_low = a - a_high, b - b_high
    return a_low * b_low - (((a * b - a_high * b_high) - a_low * b_high) - a_high * b_low)


def _upper_half(a: np.ndarray) -> np.ndarray:
    scaled = SPLITTER * a
    return scaled - (scaled - a)


def _zero_area_rational(points: np.ndarray) -> bool:
    a, b, c = ([Fraction(float(x)) for x in point] for point in points)
    p = [x - y for x, y in zip(b, a, strict=True)]
    q = [x - y for x, y in zip(c, a, strict=True)]
    return all(p[i] * q[j] == p[j] * q[i] for i, j in ((0, 1), (1, 2), (2, 0)))
