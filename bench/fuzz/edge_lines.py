"""Points and grids along the lines of edges, where near-degenerate triangles mislead: in triangles (F,3,3)."""

from __future__ import annotations

import numpy as np

import sdm


def points_in_line(corner: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """Points (N,3) float32 on the edges' lines and just beside them, between their ends and up to half beyond."""
    corner = corner.astype(np.float64)
    face, side = rng.integers(0, len(corner), count), rng.integers(0, 3, count)
    edge = corner[face, (side + 1) % 3] - corner[face, side]
    along = rng.uniform(-0.5, 1.5, (count, 1))
    # A third of them close to an end.
    along[::3] = np.round(along[::3]) + 10.0 ** rng.uniform(-8, -1, along[::3].shape) * rng.choice([-1, 1])
    points = corner[face, side] + along * edge
    off = 10.0 ** rng.uniform(-9, 0, (count, 1)) * np.linalg.norm(edge, axis=1, keepdims=True)
    points[::2] += (off * rng.normal(size=(count, 3)))[::2]
    return points.astype(np.float32)


def grid_in_line(corner: np.ndarray, rng: np.random.Generator, voxels: int) -> sdm.Grid:
    """A grid with an axis along an edge of one triangle, and a voxel centre on its corner."""
    triangle = corner[rng.integers(0, len(corner))].astype(np.float64)
    edge = triangle[1] - triangle[0]
    axes, _ = np.linalg.qr(np.stack([edge, *rng.normal(size=(2, 3))], 1))
    axes[:, 2] *= np.linalg.det(axes)
    spacing = max(float(np.linalg.norm(edge)), 1e-3) * 10.0 ** rng.uniform(-2, 0.3) * 2 / voxels
    origin = triangle[rng.integers(0, 3)] - axes @ np.full(3, voxels // 2 * spacing)
    return sdm.Grid(origin, [spacing] * 3, [voxels] * 3, direction=[[float(x) for x in row] for row in axes])
