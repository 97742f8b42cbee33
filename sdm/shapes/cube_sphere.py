"""The surface of a cube, cut into squares, and what it becomes on a sphere and on a cylinder."""

from __future__ import annotations

import numpy as np

from sdm.shapes.tube import square_triangles


def cube_surface(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """The surface of [-1,1]^3 with `cells` squares along each edge.

    Returns:
        (6 cells^2 + 2, 3) float64 points, and (12 cells^2, 3) int32 faces, counter-clockwise seen from outside.
    """
    steps = np.arange(cells + 1)
    i, j = (g.reshape(-1) for g in np.meshgrid(steps, steps, indexing="ij"))
    triangles = square_triangles(cells)
    places, faces = [], []
    for axis in range(3):
        for side in (0, cells):
            corner = np.empty((len(i), 3), dtype=np.int64)
            corner[:, axis], corner[:, (axis + 1) % 3], corner[:, (axis + 2) % 3] = side, i, j
            faces.append((triangles if side else triangles[:, ::-1]) + len(i) * len(places))
            places.append(corner)
    unique, inverse = np.unique(np.concatenate(places), axis=0, return_inverse=True)
    return 2 * unique / cells - 1, inverse.reshape(-1)[np.concatenate(faces)].astype(np.int32)


def unit_sphere(cube: np.ndarray) -> np.ndarray:
    """Points of the cube's surface on the unit sphere, by equal angles."""
    bent = np.tan(np.pi / 4 * cube)
    return bent / np.linalg.norm(bent, axis=1, keepdims=True)


def unit_cylinder(cube: np.ndarray) -> np.ndarray:
    """Points of the cube's surface on the cylinder of radius 1 and half-length 1 about z (concentric map)."""
    x, y, z = cube.T
    level = np.maximum(np.abs(x), np.abs(y))
    safe = np.where(level > 0, level, 1)
    wide = np.abs(x) >= np.abs(y)
    angle = np.pi / 4 * np.where(wide, y, x) / safe
    main, other = level * np.cos(angle), level * np.sin(angle)
    return np.stack([np.where(wide, np.sign(x) * main, other), np.where(wide, other, np.sign(y) * main), z], 1)
