"""Vertices and triangles of a file as a mesh has them: finite, float32 and int32, one vertex at a position."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sdm.errors import MeshError
from sdm.inspect.positions import are_distinct, first_at_position


def checked_and_merged(vertices: np.ndarray, faces: np.ndarray, path: Path) -> tuple[np.ndarray, np.ndarray, float]:
    """Vertices (V,3) float32, faces (F,3) int32, and the largest absolute coordinate.

    Args:
        vertices: (V,3) floats.
        faces: (F,3) integers, each the number of a vertex.
        path: The file, for messages.

    Raises:
        MeshError: There are no triangles, or a coordinate is not finite in float32.
    """
    if len(faces) == 0:
        raise MeshError(f"{path} has no triangles; give a surface mesh, not points or lines")
    largest = float(np.finfo(np.float32).max)
    # Of all numbers at once, as rows of three take NumPy ten times as long. NaN is not at most anything.
    low, high = float(vertices.min()), float(vertices.max())
    if not (high <= largest and low >= -largest):
        wrong = ~np.isfinite(vertices).all(1) | (np.abs(vertices) > largest).any(1)
        index = int(np.flatnonzero(wrong)[0])
        raise MeshError(f"vertex {index} of {path} is {vertices[index].tolist()}; every coordinate must be finite")
    return *_merge(vertices.astype(np.float32, copy=False), faces), max(high, -low)


def _merge(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drop vertices at the position of an earlier one; the order of the others stays."""
    # Of a closed mesh with shared vertices there are half as many as faces, and mostly each has its own place.
    if len(vertices) < 2 * len(faces) and are_distinct(vertices):
        return vertices, faces.astype(np.int32, copy=False)
    first = first_at_position(vertices)
    kept = first == np.arange(len(vertices))
    number = np.cumsum(kept) - 1
    return vertices[kept], number[first[faces]].astype(np.int32)
