"""OBJ files: the vertices and faces; what they look like is passed over."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from sdm.errors import MeshError
from sdm.io.meshes.damage import require_coordinates
from sdm.io.meshes.polygons import PolygonMesh
from sdm.io.meshes.text_rows import ScannedLines, TextRows, as_bytes, as_integers, parse_rows, plain_lines

# With the end of the line before, since a search for plain text is much faster than one for the begin of a line.
VERTEX = re.compile(rb"\n[ \t]*v[ \t]([^\n#]*)")
# `fo` is an older name of `f`.
FACE = re.compile(rb"\n[ \t]*fo?(?!\S)([^\n#]*)")
# The same to the kernel.
VERTEX_LINE, FACE_LINE = 1, 2
TEXTURE_AND_NORMAL = re.compile(rb"/\S*")


def read_obj(data: bytes, path: Path) -> PolygonMesh:
    """Vertices and polygons of an OBJ file, whatever its groups and materials.

    Raises:
        MeshError: A vertex of fewer than three coordinates, a face of fewer than three corners, or one that uses a
            vertex that is not there.
        ValueError: Something that should be a number is none.
    """
    text = plain_lines(as_bytes(data))
    if b"\\" in text:
        text = text.replace(b"\\\n", b" ")
    points, faces = _rows_by_kernel(text) or _rows(text)
    require_coordinates(path, points.lengths)
    if len(faces.lengths) and faces.lengths.min() < 3:
        face = int(faces.lengths.argmin())
        raise MeshError(
            f"{path} holds less than it says, it is cut off or damaged: face {face} of {len(faces.lengths)} has "
            f"{int(faces.lengths[face])} corners"
        )
    corners = as_integers(faces.values)
    low, high = (int(corners.min()), int(corners.max())) if len(corners) else (1, 1)
    if low <= 0 and (corners == 0).any():
        raise MeshError(f"a face of {path} uses vertex 0, but OBJ files number vertices from 1")
    if low < 0:
        corners = _count_forward(corners, faces.lengths, text)
        low, high = int(corners.min()), int(corners.max())
    if low < 1 or high > len(points.starts):
        wrong = (corners < 1) | (corners > len(points.starts))
        number = int(as_integers(faces.values)[wrong][0])
        raise MeshError(f"a face of {path} uses vertex {number}, which is not there: it has {len(points.starts)}")
    return PolygonMesh(points.columns(3), faces.lengths, corners - 1)


def _rows_by_kernel(text: bytes) -> tuple[TextRows, TextRows] | None:
    """Numbers of the vertices and of the faces; None where something is not plain."""
    scanned = ScannedLines.of(text, obj=True)
    if scanned is None:
        return None
    told = scanned.vertices_and_faces()
    if told is not None:
        # With a keyword of one letter.
        points, faces = scanned.rows_alike(told[0], skip=1), scanned.rows_alike(told[1], skip=1, faces=True)
        if points is not None and faces is not None:
            return points, faces
    points = scanned.rows(scanned.of_kind(VERTEX_LINE))
    faces = scanned.rows(scanned.of_kind(FACE_LINE), faces=True)
    return None if points is None or faces is None else (points, faces)


def _rows(text: bytes) -> tuple[TextRows, TextRows]:
    text = b"\n" + text
    lines = FACE.findall(text)
    if b"/" in text:
        lines = [TEXTURE_AND_NORMAL.sub(b"", line) for line in lines]
    return parse_rows(VERTEX.findall(text)), parse_rows(lines)


def _count_forward(corners: np.ndarray, lengths: np.ndarray, text: bytes) -> np.ndarray:
    """Negative numbers of vertices, which count back from their face's line, counted from the first vertex instead."""
    text = b"\n" + text
    vertices = np.array([vertex.start() for vertex in VERTEX.finditer(text)])
    faces = np.array([face.start() for face in FACE.finditer(text)])
    above = np.repeat(np.searchsorted(vertices, faces), lengths)
    return np.where(corners < 0, above + 1 + corners, corners)
