"""Exact distances in rational arithmetic, to slivers and degenerate triangles as to any other.

A float32 or float64 number is a whole number times a power of two, so all coordinates are whole numbers in a unit that
is small enough; sums and products of whole numbers are whole numbers again. So the squared distance of a point from a
triangle is an exact fraction, also where the triangle is a segment or a point, and only the square root at the end
rounds. About 20 us for a point and a triangle.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction

import numpy as np

Vector = tuple[int, int, int]
Triangle = tuple[Vector, Vector, Vector]


def squared_distance(point: np.ndarray, corner: np.ndarray) -> Fraction:
    """The square of the distance of a point (3,) from the triangle with corners (3,3), exactly.

    Args:
        point: Finite coordinates, float32 or float64, taken as they are.
        corner: The same, of any triangle: collinear and repeated corners make it a segment or a point.
    """
    (p, a, b, c), unit = _whole(np.vstack([point, corner]))
    return _squared_distance(p, (a, b, c)) * unit**2


def distance(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance (N,) float64 of points (N,3) from the closest of all triangles, rounded once or twice at the end."""
    whole, unit = _whole(np.concatenate([vertices, points]))
    corner = np.asarray(vertices, np.float64)[np.asarray(faces)]
    centre = corner.mean(1)
    radius = np.linalg.norm(corner - centre[:, None], axis=-1).max(1)
    found = np.empty(len(points))
    for number, point in enumerate(np.asarray(points, np.float64)):
        # What is further than another triangle at any rate need not be measured: nine digits are more than enough.
        away = np.linalg.norm(point - centre, axis=-1)
        within = away - radius <= (away + radius).min() + 1e-9 * (np.abs(point).max() + np.abs(corner).max())
        triangles = ([whole[v] for v in face] for face in np.asarray(faces)[within])
        p = whole[len(vertices) + number]
        found[number] = math.sqrt(min(_squared_distance(p, (a, b, c)) for a, b, c in triangles) * unit**2)
    return found


def _squared_distance(p: Vector, corner: Triangle) -> Fraction:
    a, b, c = corner
    least = min(_from_segment(p, start, end) for start, end in ((a, b), (b, c), (c, a)))
    normal = _cross(_minus(b, a), _minus(c, a))
    area2 = _dot(normal, normal)
    if area2 == 0:
        return least
    for start, end in ((a, b), (b, c), (c, a)):
        if _dot(_cross(normal, _minus(end, start)), _minus(p, start)) < 0:
            return least
    return Fraction(_dot(normal, _minus(p, a)) ** 2, area2)


def _whole(rows: np.ndarray) -> tuple[list[Vector], Fraction]:
    """Coordinates (N,3) as whole numbers, and the unit that they are in."""
    ratios = [[value.as_integer_ratio() for value in row] for row in np.asarray(rows, np.float64).tolist()]
    # Denominators are powers of two.
    unit = max(below for row in ratios for _, below in row)
    return [tuple(above * (unit // below) for above, below in row) for row in ratios], Fraction(1, unit)


def _minus(u: Vector, v: Vector) -> Vector:
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


def _dot(u: Vector, v: Vector) -> int:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _cross(u: Vector, v: Vector) -> Vector:
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


def _from_segment(p: Vector, start: Vector, end: Vector) -> Fraction:
    edge, to_point = _minus(end, start), _minus(p, start)
    length2, along = _dot(edge, edge), _dot(to_point, edge)
    if along <= 0 or length2 == 0:
        return Fraction(_dot(to_point, to_point))
    if along >= length2:
        beyond = _minus(p, end)
        return Fraction(_dot(beyond, beyond))
    return Fraction(_dot(to_point, to_point) * length2 - along**2, length2)


def winding_number(corners: np.ndarray, point: np.ndarray, seed: int = 0) -> int:
    """The winding number of triangles (F,3,3) that close a surface, around a point (3,) off it, exactly.

    Signed crossings of a ray. Its direction is drawn again where it meets an edge, so nothing is rounded or nudged.

    Raises:
        ValueError: The point lies on the surface.
    """
    rng = np.random.default_rng(seed)
    rows, _ = _whole(np.vstack([point, corners.reshape(-1, 3)]))
    around = [_minus(row, rows[0]) for row in rows[1:]]
    triangles = list(zip(around[::3], around[1::3], around[2::3], strict=True))
    for _ in range(_DIRECTIONS):
        x, y, z = rng.integers(-(10**6), 10**6, 3).tolist()
        crossings = _crossings(triangles, (x, y, z))
        if crossings is not None:
            return crossings
    raise ValueError("the point lies on the surface")


# A random direction meets an edge with next to no probability, unless the point is on the surface.
_DIRECTIONS = 8


def _crossings(triangles: Iterable[Triangle], ray: Vector) -> int | None:
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
