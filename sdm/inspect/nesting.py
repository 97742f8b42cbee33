"""Components of a mesh inside other components, by winding numbers."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int64, Integer

# Solid angles that the search may cost.
MOST_SOLID_ANGLES = 20_000_000
# Middles of faces that stand for all of a component.
SAMPLES = 16
CHUNK = 1 << 18


class Nesting:
    """Winding numbers of components about other components.

    Args:
        corners: (F,3,3) float64.
        component: (F,) the component of each face, -1 for none; every component has a face.
        solid: (C,) the components that have an inside.
        closed: (C,) the components without a gap, whose winding number is 0 outside their box.
    """

    def __init__(
        self,
        corners: Float64[np.ndarray, "F 3 3"],
        component: Integer[np.ndarray, " F"],
        solid: Bool[np.ndarray, " C"],
        closed: Bool[np.ndarray, " C"],
    ) -> None:
        order = np.argsort(component, kind="stable")
        self._corners, self._solid, self._closed = corners[order], solid, closed
        numbers = np.arange(len(solid))
        self._begin, self._end = (np.searchsorted(component[order], numbers, side=side) for side in ("left", "right"))
        first = self._begin[0]
        self._low = np.minimum.reduceat(self._corners[first:].min(1), self._begin - first)
        self._high = np.maximum.reduceat(self._corners[first:].max(1), self._begin - first)
        self._left = MOST_SOLID_ANGLES

    def around(self, inner: int | np.integer) -> Int64[np.ndarray, " n"]:
        """The other solid components that component `inner` may be inside."""
        near = self._solid & (~self._closed | self._touches(inner))
        near[inner] = False
        return np.flatnonzero(near)

    def within(self, outer: int | np.integer) -> Int64[np.ndarray, " n"]:
        """The other components, sheets too, that may be inside component `outer`."""
        near = self._touches(outer)
        near[outer] = False
        return np.flatnonzero(near)

    def winding(self, outer: int | np.integer, inner: int | np.integer) -> float | None:
        """Mean winding number of a component about some faces of another; None once that has taken too long."""
        size = self._end[inner] - self._begin[inner]
        faces = self._begin[inner] + np.unique(np.linspace(0, size - 1, SAMPLES).astype(np.int64))
        triangles = self._corners[self._begin[outer] : self._end[outer]]
        self._left -= len(faces) * len(triangles)
        if self._left < 0:
            return None
        return float(np.mean([winding_number(point, triangles) for point in self._corners[faces].mean(1)]))

    def _touches(self, one: int | np.integer) -> np.ndarray:
        return ((self._low <= self._high[one]) & (self._low[one] <= self._high)).all(1)


def winding_number(point: Float64[np.ndarray, " 3"], corners: Float64[np.ndarray, "F 3 3"]) -> float:
    """Winding number of triangles (F,3,3) about a point (3,), by solid angles (van Oosterom and Strackee 1983)."""
    total = 0.0
    for begin in range(0, len(corners), CHUNK):
        a, b, c = np.moveaxis(corners[begin : begin + CHUNK] - point, 1, 0)
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        volume = (a * np.cross(b, c)).sum(1)
        below = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        total += float(np.arctan2(volume, below).sum())
    return total / (2 * np.pi)
