"""Polygon meshes as files declare them, and their triangles: fans where those are right, else ear clipping."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sdm.errors import MeshError

# A fan's triangle that faces the wrong way by less than this share of the polygon's area is rounding of the file.
FAN_ROUNDING = 1e-6


@dataclass(frozen=True)
class PolygonMesh:
    """Vertices and polygons of any number of corners.

    Args:
        vertices: (V,3) float64, or float32 where the file has no more digits.
        lengths: (F,) int64: corners of each polygon; one number if it is that of all.
        corners: (sum of lengths,) int64 or int32: vertex numbers, counted from 0, one polygon after the other.
    """

    vertices: np.ndarray
    lengths: np.ndarray | int
    corners: np.ndarray

    @classmethod
    def of_triangles(cls, vertices: np.ndarray, faces: np.ndarray) -> PolygonMesh:
        """The mesh of vertices (V,3) and triangles (F,3)."""
        return cls(vertices, 3, faces.ravel())


def check_indices(corners: np.ndarray, count: int, path: Path) -> None:
    """Refuse corners, an array of any shape, that are not the numbers of `count` vertices.

    Raises:
        MeshError: Names the vertex.
    """
    if corners.size and (corners.min() < 0 or corners.max() >= count):
        bad = int(corners.min() if corners.min() < 0 else corners.max())
        raise MeshError(f"a face of {path} uses vertex {bad}, but it has {count} vertices counted from 0")


def triangulate(mesh: PolygonMesh) -> np.ndarray:
    """Triangles (T,3), integers, in the order of the polygons; every corner must be the number of a vertex.

    A polygon of K corners becomes K-2 triangles that use all of them, so that neighbours fit; one of fewer than three
    corners has none.
    """
    lengths = mesh.lengths
    if isinstance(lengths, int) and lengths != 3:
        lengths = np.full(len(mesh.corners) // max(1, lengths), lengths)
    if isinstance(lengths, int) or (lengths == 3).all():
        return mesh.corners.reshape(-1, 3)
    vertices = mesh.vertices.astype(np.float64, copy=False)
    starts = np.cumsum(lengths) - lengths
    counts = np.maximum(lengths - 2, 0)
    firsts = np.cumsum(counts) - counts
    triangles = np.empty((int(counts.sum()), 3), np.int64)
    for length in np.unique(lengths[lengths >= 3]).tolist():
        own = np.flatnonzero(lengths == length)
        polygons = mesh.corners[starts[own, None] + np.arange(length)]
        steps = np.arange(1, length - 1)
        cut = polygons[:, np.stack([0 * steps, steps, steps + 1], 1)]
        if length > 3:
            for number in np.flatnonzero(wrong_fans(vertices, polygons)).tolist():
                cut[number] = polygons[number][clip_ears(vertices[polygons[number]])]
        triangles[firsts[own, None] + np.arange(length - 2)] = cut
    return triangles


def wrong_fans(vertices: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """Mask (M,) of the polygons (M,K) of vertices (V,3) that a fan from the first corner would not fill rightly.

    A fan is right if all of its triangles face the way of the polygon: for every convex polygon, and some others.
    """
    corners = vertices[polygons]
    spokes = corners[:, 1:] - corners[:, :1]
    triangles = np.cross(spokes[:, :-1], spokes[:, 1:])
    # Newell's normal, as long as twice the area.
    normal = triangles.sum(1)
    along = np.einsum("mkd,md->mk", triangles, normal)
    return (along < -FAN_ROUNDING * (normal**2).sum(1, keepdims=True)).any(1)


def clip_ears(corners: np.ndarray) -> np.ndarray:
    """The K-2 triangles (K-2,3) of a polygon with corners (K,3) in order, concave or not, which face as it does.

    The work is done in the plane of Newell's normal. A polygon that cuts itself there has no right triangles; it
    becomes a fan.
    """
    import mapbox_earcut

    count = len(corners)
    steps = np.arange(1, count - 1)
    fan = np.stack([0 * steps, steps, steps + 1], 1)
    if not wrong_fans(corners, np.arange(count)[None]).any():
        return fan
    flat = _in_plane(corners)
    found = mapbox_earcut.triangulate_float64(flat, np.array([count], np.uint32)).reshape(-1, 3).astype(np.int64)
    size = _doubled_areas(flat, fan).sum()
    areas = _doubled_areas(flat, found)
    # The polygon runs counterclockwise in its plane; ear clipping promises no direction.
    if areas.sum() < 0:
        found, areas = found[:, ::-1], -areas
    filled = len(found) == count - 2 and abs(np.abs(areas).sum() - size) <= FAN_ROUNDING * size
    return found if filled else fan


def _in_plane(corners: np.ndarray) -> np.ndarray:
    """Coordinates (K,2) in which the polygon runs counterclockwise."""
    spokes = corners[1:] - corners[0]
    normal = np.cross(spokes[:-1], spokes[1:]).sum(0)
    normal = normal / np.linalg.norm(normal)
    right = np.cross(np.eye(3)[np.abs(normal).argmin()], normal)
    right /= np.linalg.norm(right)
    at = corners - corners[0]
    return np.stack([at @ right, at @ np.cross(normal, right)], 1)


def _doubled_areas(flat: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Twice the signed areas (T,) of triangles (T,3) of points (K,2), positive if counterclockwise."""
    a, b, c = np.moveaxis(flat[triangles], 1, 0)
    to_b, to_c = b - a, c - a
    return to_b[:, 0] * to_c[:, 1] - to_b[:, 1] * to_c[:, 0]
