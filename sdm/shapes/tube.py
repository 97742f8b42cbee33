"""Topology of a capped tube: rings along a line, and a grid of triangles over each end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Tube:
    """A closed tube of `steps` + 1 rings of 4 `cells` vertices, its ends closed by cells x cells squares each.

    Args:
        station: (V,) int32, the ring that each vertex belongs to; a cap's vertices belong to the ring they fill.
        section: (V,2) float64, each vertex's place in the unit section.
        faces: (F,3) int32, counter-clockwise seen from outside if sections run counter-clockwise seen against the
            line's direction.
    """

    station: np.ndarray
    section: np.ndarray
    faces: np.ndarray


def tube(steps: int, ring: np.ndarray) -> Tube:
    """The tube with `steps` steps along the line and the unit section `ring` (4 cells, 2), star-shaped about (0,0)."""
    around = ring.shape[0]
    cells = around // 4
    inner, place, cap = _disc(cells, ring)
    count = (steps + 1) * around
    station = np.concatenate(
        [np.repeat(np.arange(steps + 1), around), np.zeros(len(inner), int), np.full(len(inner), steps)]
    )
    section = np.concatenate([np.tile(ring, (steps + 1, 1)), inner, inner])

    i, j = np.meshgrid(np.arange(steps), np.arange(around), indexing="ij")
    a, b = i * around + j, i * around + (j + 1) % around
    c, d = a + around, b + around
    side = np.concatenate([np.stack([a, d, b], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    # Grid vertices of a cap: those on the ring (place >= 0) and the inner ones, numbered after all rings.
    first = np.where(place >= 0, place, count + np.cumsum(place < 0) - 1)
    last = np.where(place >= 0, steps * around + place, count + len(inner) + np.cumsum(place < 0) - 1)
    faces = np.concatenate([side, first[cap], last[cap[:, ::-1]]])
    return Tube(station.astype(np.int32), section, faces.astype(np.int32))


def superellipse(count: int, top: float, bottom: float, flatness: float = 0.5) -> np.ndarray:
    """Points (count,2) on |x|^n + |y|^n = 1, n = `top` for y >= 0 and `bottom` for y < 0, evenly spaced by length.

    They run counter-clockwise from (1,0); lengths are measured with y scaled by `flatness`.
    """
    angle = np.linspace(0, 2 * np.pi, 40_001)
    x, y = np.cos(angle), np.sin(angle)
    exponent = 2 / np.where(y >= 0, top, bottom)
    x, y = np.sign(x) * np.abs(x) ** exponent, np.sign(y) * np.abs(y) ** exponent
    length = np.concatenate([[0], np.cumsum(np.hypot(np.diff(x), flatness * np.diff(y)))])
    at = np.linspace(0, length[-1], count + 1)[:-1]
    return np.stack([np.interp(at, length, x), np.interp(at, length, y)], 1)


def square_triangles(cells: int) -> np.ndarray:
    """Triangles (2 cells^2, 3) of a square of (cells + 1)^2 vertices, counter-clockwise, diagonals towards its corners.

    Such diagonals keep every triangle healthy where the square is mapped to a disc.
    """
    i, j = np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij")
    a = i * (cells + 1) + j
    b, c, d = a + cells + 1, a + cells + 2, a + 1
    rising = (2 * i + 1 < cells) == (2 * j + 1 < cells)
    first = np.where(rising[..., None], np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(rising[..., None], np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    return np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])


def _disc(cells: int, ring: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A square grid of vertices laid over the section: inner points, each grid vertex's place on the ring or -1, faces.

    Squares around the centre become scaled rings, as in the concentric map of Shirley and Chiu, 1997.
    """
    around = 4 * cells
    steps = np.linspace(-1, 1, cells + 1)
    x, y = (g.reshape(-1) for g in np.meshgrid(steps, steps, indexing="ij"))
    level = np.maximum(np.abs(x), np.abs(y))
    safe = np.where(level > 0, level, 1)
    # Where a vertex is around its square, in eighths of the way round, from (1,0) counter-clockwise.
    u, v = x / safe, y / safe
    eighths = np.select([(u == 1) & (v > -1), (v == 1) & (u < 1), (u == -1) & (v < 1)], [v, 2 - u, 4 - v], 6 + u)
    position = np.mod(eighths / 8, 1) * around
    position = np.where(level > 0, position, 0)
    closed = np.concatenate([ring, ring[:1]])
    points = level[:, None] * np.stack([np.interp(position, np.arange(around + 1), closed[:, k]) for k in (0, 1)], 1)
    on_ring = np.isclose(level, 1)
    place = np.where(on_ring, np.mod(np.round(position).astype(int), around), -1)
    return points[~on_ring], place, square_triangles(cells)
