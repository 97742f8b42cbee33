"""Caps of dirty meshes, balls around points among them, and the caps' exact shares there."""

from __future__ import annotations

import hashlib

import numpy as np

from sdm.bench.common.dirty_meshes.by_code import boxes, half_spheres, loose, torn, turned
from sdm.bench.common.meshes import torus
from tests.helpers import oracle

MESHES = {
    "torn": lambda: torn(torus(2000), 0.3),
    "turned": lambda: turned(torus(2000), 0.5),
    "loose": lambda: loose(torus(2000), 0.01),
    "half spheres": lambda: half_spheres(60, 8),
    "boxes": lambda: boxes(60),
}


# Shares of the last few caps and points: tests ask for the same at every tolerance, and they take longer than all else.
_known: dict[bytes, np.ndarray] = {}
MOST_KNOWN = 4


def exact_shares(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Solid angles of triangles (N, 3, 3) seen from points (P, 3), summed, over a full one (P,), in float64."""
    corners, points = corners.astype(np.float64), points.astype(np.float64)
    key = hashlib.sha256(corners.tobytes() + points.tobytes()).digest()
    if key not in _known:
        if len(_known) >= MOST_KNOWN:
            _known.pop(next(iter(_known)))
        faces = np.arange(3 * len(corners)).reshape(-1, 3)
        _known[key] = oracle.winding_number(corners.reshape(-1, 3), faces, points)
    return _known[key]


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
