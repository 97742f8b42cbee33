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


def winding_number(corners: np.ndarray, point: np.ndarray, seed: int = 0) -> int:
    """The winding number of triangles (F,3,3) that close a surface, around a point (3,) off it, exactly.

    Signed crossings of a ray. Its direction is drawn again where it meets an edge, so nothing is rounded or nudged.

    Raises:
        ValueError: The point lies on the surface.
    """
    rng = np.random.default_rng(seed)
    p = _vector(point)
    triangles = [tuple(_minus(_vector(row), p) for row in corner) for corner in corners]
    for _ in range(_DIRECTIONS):
        crossings = _crossings(triangles, _vector(rng.integers(-(10**6), 10**6, 3)))
        if crossings is not None:
            return crossings
    raise ValueError("the point lies on the surface")


# A random direction meets an edge with next to no probability, unless the point is on the surface.
_DIRECTIONS = 8


def _crossings(triangles: list[tuple[Vector, ...]], ray: Vector) -> int | None:
    """Signed crossings of a ray from the origin; None if it meets an edge or starts on a triangle."""
    total = 0
    for a, b, c in triangles:
        sides = [_dot(ray, _cross(u, v)) for u, v in ((a, b), (b, c), (c, a))]
        if any(s > 0 for s in sides) and any(s < 0 for s in sides):
            continue
        if not any(sides):
            # Edge-on, or without area: touched only if the ray's line meets one of its edges.
            if _touches(a, b, ray) or _touches(b, c, ray) or _touches(c, a, ray):
                return None
            continue
        volume = _dot(a, _cross(b, c))
        if volume == 0 or not all(sides):
            return None
        # The ray leaves through a face that it sees from behind.
        if (volume > 0) == (sides[0] > 0):
            total += 1 if sides[0] > 0 else -1
    return total


def _touches(u: Vector, v: Vector, ray: Vector) -> bool:
    """True unless the segment u-v clearly misses the ray from the origin, all four in one plane."""
    across = _cross(ray, u), _cross(ray, v)
    return _dot(*across) <= 0
