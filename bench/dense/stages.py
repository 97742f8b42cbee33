"""The stages of the fast dense path in the plane, in NumPy: the test of kernels/culling/witness_bound.py, on segments.

Cells of 8x8 pixels keep the segments that can be nearest to any of their pixels; octants of 4x4 (of which a cell has
four in the plane) filter their cell's list once more; the pixels of an octant are measured from what is left. The same
names as in the kernels: c and a are a cell's centre and half-widths, y the known nearest surface point (the witness).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CELL, OCTANT = 8, 4


@dataclass(frozen=True)
class Box:
    """A cell or octant: centre c (2,), half-widths a (2,), of its pixels' centres."""

    centre: np.ndarray
    half: np.ndarray


def boxes(low: float, step: float, count: int, edge: int) -> list[Box]:
    """Boxes of `edge` x `edge` pixels of a square of `count` x `count`, pixel (0,0) at (low, low), row by row."""
    middles = low + step * (edge * np.arange(count // edge) + (edge - 1) / 2)
    half = np.full(2, step * (edge - 1) / 2)
    return [Box(np.array([x, y]), half) for x in middles for y in middles]


def closest_points(p: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Closest points (S,2) of segments (S,2,2) to p (2,)."""
    a, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    t = ((p - a) * along).sum(1) / np.maximum((along * along).sum(1), 1e-300)
    return a + np.clip(t, 0, 1)[:, None] * along


def witness(box: Box, segments: np.ndarray) -> np.ndarray:
    """y: the surface point nearest to the box's centre, among these segments."""
    near = closest_points(box.centre, segments)
    return near[((near - box.centre) ** 2).sum(1).argmin()]


def too_far(box: Box, y: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Distance alone: T is further from the centre than y by twice the box's radius. (S,) bool."""
    far = np.linalg.norm(closest_points(box.centre, segments) - box.centre, axis=1)
    return far > np.linalg.norm(y - box.centre) + 2 * np.linalg.norm(box.half)


def leads(box: Box, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Least of |p - x|^2 - |p - y|^2 over the places p of a box, for points x (S,2). (S,)

    |p - x|^2 - |p - y|^2 is linear in p, and least at a corner of the box.
    """
    at_centre = ((box.centre - x) ** 2).sum(1) - ((box.centre - y) ** 2).sum()
    return at_centre - 2 * (box.half * np.abs(x - y)).sum(1)


def is_farther(box: Box, y: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """No point of T is nearer to any pixel of the box than y, so that T can be dropped. (S,) bool.

    A point between T's ends is nearer by a quarter of T's squared length at most than the worse of them, squared.
    """
    ends = np.minimum(leads(box, y, segments[:, 0]), leads(box, y, segments[:, 1]))
    return ends > ((segments[:, 1] - segments[:, 0]) ** 2).sum(1) / 4


def kept(box: Box, segments: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Numbers of those of the segments `among` that the box keeps."""
    some = segments[among]
    return among[~is_farther(box, witness(box, some), some)]


def pixel_distances(box: Box, step: float, edge: int, segments: np.ndarray) -> np.ndarray:
    """Distances (edge, edge) of a box's pixels from segments, and nothing else."""
    offsets = step * (np.arange(edge) - (edge - 1) / 2)
    found = np.empty((edge, edge))
    for i, x in enumerate(offsets):
        for j, z in enumerate(offsets):
            p = box.centre + np.array([x, z])
            found[i, j] = np.sqrt(((closest_points(p, segments) - p) ** 2).sum(1).min())
    return found


def is_inside(p: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """True for points (N,2) inside closed curves, by crossings to the right. (N,)"""
    inside = np.zeros(len(p), bool)
    for a, b in segments:
        spans = (a[1] <= p[:, 1]) != (b[1] <= p[:, 1])
        if a[1] != b[1]:
            inside ^= spans & (p[:, 0] < a[0] + (p[:, 1] - a[1]) * (b[0] - a[0]) / (b[1] - a[1]))
    return inside
