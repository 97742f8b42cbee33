"""The float64 brute force that everything else is measured against: NumPy alone, every triangle for every point.

Nothing here shares code or method with the engine. Triangles of any shape count: the closest point is searched on
the three edges and, where a point projects into the triangle, on its plane. Inputs are taken as float32 numbers, so
float64 holds their differences exactly or nearly so.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

# One step takes this many points by this many triangles: about 100 MB of temporaries, whatever the input.
POINTS, TRIANGLES = 256, 512
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
    closest = np.full((len(points), 3), np.nan)
    face = np.full(len(points), -1)
    for some, begin, end in _steps(len(points), len(corner)):
        offset = closest_on_triangles(points[some, None], corner[None, begin:end])
        length = _dot(offset, offset)
        best = length.argmin(1)
        row = np.arange(len(best))
        better = length[row, best] < squared[some]
        at = np.arange(some.start, some.stop)[better]
        row, best = row[better], best[better]
        squared[at], face[at] = length[row, best], begin + best
        closest[at] = points[at] - offset[row, best]
    return np.sqrt(squared), closest, face


def winding_number(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Generalised winding number of the triangles about points (N,3): (N,) float64, 1 inside a closed surface.

    The solid angles of all triangles, added up and divided by 4 pi: A. van Oosterom and J. Strackee, The solid angle
    of a plane triangle, IEEE Trans. Biomed. Eng. 30(2), 1983. On the surface itself it is not defined.
    """
    corner = np.asarray(vertices, np.float64)[np.asarray(faces)]
    points = np.asarray(points, np.float64)
    total = np.zeros(len(points))
    for some, begin, end in _steps(len(points), len(corner)):
        a, b, c = np.moveaxis(corner[None, begin:end] - points[some, None, None], 2, 0)
        la, lb, lc = np.linalg.norm(a, axis=-1), np.linalg.norm(b, axis=-1), np.linalg.norm(c, axis=-1)
        volume = _dot(a, np.cross(b, c))
        divisor = la * lb * lc + _dot(a, b) * lc + _dot(b, c) * la + _dot(c, a) * lb
        total[some] += np.arctan2(volume, divisor).sum(1)
    return total / (2 * np.pi)


def closest_on_triangles(points: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """From the closest point on each triangle to each point: (...,3), for points (...,3) and corners (...,3,3)."""
    a, b, c = corner[..., 0, :], corner[..., 1, :], corner[..., 2, :]
    best = _from_plane(points, corner)
    squared = _dot(best, best)
    for start, end in ((a, b), (b, c), (c, a)):
        offset = _from_segment(points, start, end)
        length = _dot(offset, offset)
        # Not "<": where the point does not project into the triangle, the plane gave NaN.
        better = ~(squared <= length)
        best = np.where(better[..., None], offset, best)
        squared = np.where(better, length, squared)
    return best


def _from_segment(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    edge, to_point = end - start, points - start
    squared = _dot(edge, edge)
    along = _dot(to_point, edge) / np.where(squared > 0, squared, 1)
    return to_point - np.clip(along, 0, 1)[..., None] * edge


def _from_plane(points: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """From the projections of points into triangles to the points; NaN where they fall outside or there is no plane.

    Each triangle gets a frame on its longest edge: x along it, y towards the third corner. y is made square to x
    twice, so that a sliver's plane may turn about its long edge by rounding, which changes no distance to first
    order, but never tilts along it.
    """
    edges = np.roll(corner, -1, -2) - corner
    longest = _dot(edges, edges).argmax(-1)[..., None, None]
    base, edge, back = (
        np.take_along_axis(array, (longest + shift) % 3, -2)[..., 0, :]
        for array, shift in ((corner, 0), (edges, 0), (edges, 2))
    )
    length = np.linalg.norm(edge, axis=-1)
    x = edge / np.where(length > 0, length, 1)[..., None]
    rise = -back  # from the base to the third corner
    across = rise - _dot(rise, x)[..., None] * x
    across -= _dot(across, x)[..., None] * x
    height = np.linalg.norm(across, axis=-1)
    y = across / np.where(height > 0, height, 1)[..., None]
    y -= _dot(y, x)[..., None] * x
    top = _dot(rise, x)

    to_point = points - base
    px, py = _dot(to_point, x), _dot(to_point, y)
    inside = (py >= 0) & (height * px >= top * py) & (height * (length - px) >= (length - top) * py)
    inside &= height > NARROWEST * length
    offset = to_point - px[..., None] * x - py[..., None] * y
    return np.where(inside[..., None], offset, np.nan)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)


def _steps(points: int, triangles: int) -> Iterator[tuple[slice, int, int]]:
    for first in range(0, points, POINTS):
        for begin in range(0, triangles, TRIANGLES):
            yield slice(first, min(first + POINTS, points)), begin, min(begin + TRIANGLES, triangles)
