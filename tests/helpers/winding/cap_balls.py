"""Caps of dirty meshes, balls around points among them, and the caps' exact shares there."""

from __future__ import annotations

import numpy as np

from sdm.bench.common.dirty_meshes.by_code import boxes, half_spheres, loose, torn, turned
from sdm.bench.common.meshes import torus

MESHES = {
    "torn": lambda: torn(torus(2000), 0.3),
    "turned": lambda: turned(torus(2000), 0.5),
    "loose": lambda: loose(torus(2000), 0.01),
    "half spheres": lambda: half_spheres(60, 8),
    "boxes": lambda: boxes(60),
}


def exact_shares(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Solid angles of triangles (N, 3, 3) seen from points (P, 3), summed, over a full one (P,), in float64."""
    a, b, c = np.moveaxis(corners[None].astype(float) - points[:, None, None].astype(float), 2, 0)
    la, lb, lc = (np.linalg.norm(each, axis=2) for each in (a, b, c))
    v = (a * np.cross(b, c)).sum(2)
    f = la * lb * lc + (a * b).sum(2) * lc + (b * c).sum(2) * la + (c * a).sum(2) * lb
    return (2 * np.arctan2(v, f)).sum(1) / (4 * np.pi)


def balls_among(
    corners: np.ndarray, low: np.ndarray, high: np.ndarray, count: int, inside: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres (count, 3) and radii (count,) of balls of all sizes in a box, every other one at a cap (N, 3, 3), and
    points (count, inside, 3) float32 in them.
    """
    radius = (high - low).max() * 10.0 ** rng.uniform(-3, -1.3, count)
    centres = rng.uniform(low, high, (count, 3))
    centres[::2] = corners[rng.integers(0, len(corners), count // 2)].mean(1)
    ways = rng.normal(size=(count, inside, 3))
    ways *= rng.uniform(0, 0.999, (count, inside, 1)) / np.linalg.norm(ways, axis=2, keepdims=True)
    return centres, radius, (centres[:, None] + radius[:, None, None] * ways).astype(np.float32)
