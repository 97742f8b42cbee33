"""The float64 brute force that everything else is measured against: NumPy alone, every triangle for every point.

Nothing here shares code or method with the engine. Triangles of any shape count: the closest point is searched on
the three edges and, where a point projects into the triangle, on its plane. Inputs are taken as float32 numbers, so
float64 holds their differences exactly or nearly so.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator

import numpy as np

# One step takes this many points by this many triangles: its temporaries stay in a core's cache.
POINTS, TRIANGLES = 64, 256
# A triangle narrower than this share of its longest edge has a plane that float64 cannot place; its edges are
# then within the same share of every point of it, so leaving the plane out costs no more than that.
NARROWEST = 1e-11


def distance(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance of points from the closest of all triangles.

    Args:
        vertices: (V,3) coordinates.
        faces: (F,3) vertex indices.
        points: (N,3) coordinates.

    Returns:
        Distance (N,), closest point (N,3), both float64, and the lowest face (N,) that has it. Errors are within
        about 1e-15 of the coordinates' size; for triangles thinner than 1e-11 of their length 1e-11 of that.
    """
    corner = np.asarray(vertices, np.float64)[np.asarray(faces)]
    points = np.asarray(points, np.float64)
    squared = np.full(len(points), np.inf)
    face = np.full(len(points), -1)
    of_point, of_corner = _first_axis(points), _first_axis(corner)
    for some, begin, end in _steps(len(points), len(corner)):
        lengths = _candidates(of_point[:, some, None], of_corner[:, None, begin:end])
        length = functools.reduce(np.fmin, (_dot(offset, offset) for offset in lengths))
        best = length.argmin(1)
        length = length[np.arange(len(best)), best]
        at = np.flatnonzero(length < squared[some])
        squared[some.start + at], face[some.start + at] = length[at], begin + best[at]
    offset = closest_on_triangles(points, corner[face]) if len(corner) else np.full_like(points, np.nan)
    return np.sqrt(squared), points - offset, face


def winding_number(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Generalised winding number of the triangles about points (N,3): (N,) float64, 1 inside a closed surface.

    The solid angles of all triangles, added up and divided by 4 pi: A. van Oosterom and J. Strackee, The solid angle
    of a plane triangle, IEEE Trans. Biomed. Eng. 30(2), 1983. On the surface itself it is not defined.
    """
    corner = _first_axis(np.asarray(vertices, np.float64)[np.asarray(faces)])
    point = _first_axis(np.asarray(points, np.float64))
    total = np.zeros(point.shape[1])
    for some, begin, end in _steps(*point.shape[1:], corner.shape[1]):
        a, b, c = (corner[:, None, begin:end, k] - point[:, some, None] for k in range(3))
        la, lb, lc = _length(a), _length(b), _length(c)
        volume = _dot(a, _cross(b, c))
        divisor = la * lb * lc + _dot(a, b) * lc + _dot(b, c) * la + _dot(c, a) * lb
        total[some] += np.arctan2(volume, divisor).sum(1)
    return total / (2 * np.pi)


def closest_on_triangles(points: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """From the closest point on each triangle to each point: (...,3), for points (...,3) and corners (...,3,3)."""
    best, *others = _candidates(_first_axis(points), _first_axis(corner))
    squared = _dot(best, best)
    for offset in others:
        length = _dot(offset, offset)
        # Not "<": where the point does not project into the triangle, the plane gave NaN.
        better = ~(squared <= length)
        best, squared = np.where(better, offset, best), np.where(better, length, squared)
    return np.moveaxis(best, 0, -1)


def _candidates(points: np.ndarray, corner: np.ndarray) -> Iterator[np.ndarray]:
    """Offsets (3,...) from a triangle's plane and its edges: points (3,...), corners (3,...,3)."""
    yield _from_plane(points, corner)
    for k in range(3):
        yield _from_segment(points, corner[..., k], corner[..., (k + 1) % 3])


def _from_segment(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    edge, to_point = end - start, points - start
    squared = _dot(edge, edge)
    along = _dot(to_point, edge) / np.where(squared > 0, squared, 1)
    return to_point - np.clip(along, 0, 1) * edge


def _from_plane(points: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """From the projections of points into triangles to the points; NaN where they fall outside or there is no plane.

    Each triangle gets a frame on its longest edge: x along it, y towards the third corner. y is made square to x
    twice, so that a sliver's plane may turn about its long edge by rounding, which changes no distance to first
    order, but never tilts along it.
    """
    edges = np.roll(corner, -1, -1) - corner
    longest = _dot(edges, edges).argmax(-1)[None, ..., None]
    base, edge, back = (
        np.take_along_axis(array, (longest + shift) % 3, -1)[..., 0]
        for array, shift in ((corner, 0), (edges, 0), (edges, 2))
    )
    length = _length(edge)
    x = edge / np.where(length > 0, length, 1)
    rise = -back  # from the base to the third corner
    across = rise - _dot(rise, x) * x
    across -= _dot(across, x) * x
    height = _length(across)
    y = across / np.where(height > 0, height, 1)
    y -= _dot(y, x) * x
    top = _dot(rise, x)

    to_point = points - base
    px, py = _dot(to_point, x), _dot(to_point, y)
    inside = (py >= 0) & (height * px >= top * py) & (height * (length - px) >= (length - top) * py)
    inside &= height > NARROWEST * length
    offset = to_point - px * x - py * y
    return np.where(inside, offset, np.nan)


def _first_axis(array: np.ndarray) -> np.ndarray:
    """The same with the last axis, x, y and z, first, so that NumPy goes through one coordinate after the other."""
    coordinates = np.moveaxis(array, -1, 0)
    return np.ascontiguousarray(coordinates)


def _dot(a: np.ndarray, b: np.ndarray | tuple[np.ndarray, ...]) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # NumPy's own turns its axes about for every call, which takes longer than what it computes.
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _length(a: np.ndarray) -> np.ndarray:
    return np.sqrt(_dot(a, a))


def _steps(points: int, triangles: int) -> Iterator[tuple[slice, int, int]]:
    for first in range(0, points, POINTS):
        for begin in range(0, triangles, TRIANGLES):
            yield slice(first, min(first + POINTS, points)), begin, min(begin + TRIANGLES, triangles)
