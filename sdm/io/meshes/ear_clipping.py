"""Polygons cut into triangles: as a fan where that is right, by ear clipping where it is not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# A fan's triangle that faces the wrong way by less than this share of the polygon's area is rounding of the file.
FAN_ROUNDING = 1e-6
# Corners on a line, as float32 coordinates hold them.
LINE_ROUNDING = 1e-7


def wrong_fans(vertices: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """Which of polygons (M,K) of vertices (V,3) a fan from the first corner would not fill rightly, (M,) bool.

    A fan is right if all of its triangles face the way of the polygon: for every convex polygon, and some others.
    """
    corners = vertices[polygons]
    spokes = corners[:, 1:] - corners[:, :1]
    triangles = np.cross(spokes[:, :-1], spokes[:, 1:])
    # Newell's normal, as long as twice the area.
    normal = triangles.sum(1)
    along = np.einsum("mkd,md->mk", triangles, normal)
    return (along < -FAN_ROUNDING * (normal**2).sum(1, keepdims=True)).any(1)


def find_wrong_fans(vertices: np.ndarray, polygons: Sequence[np.ndarray]) -> list[int]:
    """The numbers of the polygons, of any lengths, that a fan would not fill rightly."""
    lengths = np.array([len(polygon) for polygon in polygons])
    found: list[int] = []
    for length in np.unique(lengths[lengths > 3]):
        numbers = np.flatnonzero(lengths == length)
        found += numbers[wrong_fans(vertices, np.stack([polygons[number] for number in numbers.tolist()]))].tolist()
    return sorted(found)


def cut(corners: np.ndarray) -> list[tuple[int, int, int]]:
    """The K-2 triangles of a polygon with corners (K,3) in order, concave or not, which face as it does.

    The work is done in the plane of Newell's normal. A polygon that cuts itself there has no right triangles; it
    becomes a fan.
    """
    count = len(corners)
    fan = [(0, number, number + 1) for number in range(1, count - 1)]
    if not wrong_fans(corners, np.arange(count)[None]).any():
        return fan
    flat = _in_plane(corners)
    size = abs(_area(flat))
    return fan if _cuts_itself(flat, size) else _ears(flat, size) or fan


def _in_plane(corners: np.ndarray) -> np.ndarray:
    """Coordinates (K,2) in which the polygon runs counterclockwise."""
    spokes = corners[1:] - corners[0]
    normal = np.cross(spokes[:-1], spokes[1:]).sum(0)
    normal = normal / np.linalg.norm(normal)
    right = np.cross(np.eye(3)[np.abs(normal).argmin()], normal)
    right /= np.linalg.norm(right)
    at = corners - corners[0]
    return np.stack([at @ right, at @ np.cross(normal, right)], 1)


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Twice the signed areas of triangles, positive if counterclockwise."""
    to_b, to_c = b - a, c - a
    return to_b[..., 0] * to_c[..., 1] - to_b[..., 1] * to_c[..., 0]


def _area(flat: np.ndarray) -> float:
    return float(_turn(flat[0], flat[1:-1], flat[2:]).sum())


def _cuts_itself(flat: np.ndarray, size: float) -> bool:
    """Whether two edges cross; edges that only touch, as around a hole that a bridge leads to, do not."""
    ends = np.roll(flat, -1, 0)
    for begin, end in zip(flat, ends, strict=True):
        sides = np.stack([_turn(begin, end, flat), _turn(begin, end, ends)])
        others = np.stack([_turn(flat, ends, begin), _turn(flat, ends, end)])
        sides[np.abs(sides) < LINE_ROUNDING * size] = 0
        others[np.abs(others) < LINE_ROUNDING * size] = 0
        if ((sides.prod(0) < 0) & (others.prod(0) < 0)).any():
            return True
    return False


def _ears(flat: np.ndarray, size: float) -> list[tuple[int, int, int]] | None:
    """Ear clipping of a counterclockwise polygon; None where no ear is left although there is area."""
    left, start = list(range(len(flat))), 0
    triangles: list[tuple[int, int, int]] = []
    while len(left) > 3:
        points = flat[left]
        # An ear with corners on its edge would leave a sliver that faces the other way: the last resort.
        ear = next((e for slack in (LINE_ROUNDING * size, 0.0) if (e := _ear(points, start, slack)) is not None), None)
        if ear is None:
            if abs(_area(points)) > FAN_ROUNDING * size:
                return None
            return triangles + [(left[0], left[n], left[n + 1]) for n in range(1, len(left) - 1)]
        triangles.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        left.pop(ear)
        # Going on from here, not from the first corner again, makes fewer slivers.
        start = ear % len(left)
    return [*triangles, (left[0], left[1], left[2])]


def _ear(points: np.ndarray, start: int, slack: float) -> int | None:
    """The first corner from `start` on that can be cut off: it turns left, and no other corner is in its triangle."""
    before, after = np.roll(points, 1, 0), np.roll(points, -1, 0)
    turns = _turn(before, points, after)
    # Where any corner is in the triangle, one that does not turn left is.
    others = points[turns <= slack]
    candidates = np.flatnonzero(turns > slack)
    for ear in np.roll(candidates, -int(np.searchsorted(candidates, start))):
        a, b, c = before[ear], points[ear], after[ear]
        inside = np.minimum(np.minimum(_turn(a, b, others), _turn(b, c, others)), _turn(c, a, others)) >= -slack
        same = (others == a).all(1) | (others == b).all(1) | (others == c).all(1)
        if not (inside & ~same).any():
            return int(ear)
    return None
