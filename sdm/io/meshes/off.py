"""OFF files: a header with counts, a line for each vertex, a line for each face."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from sdm.errors import MeshError
from sdm.io.meshes.damage import require_coordinates, require_corners, require_count
from sdm.io.meshes.polygons import PolygonMesh
from sdm.io.meshes.text_rows import (
    ScannedLines,
    TextRows,
    as_bytes,
    as_integers,
    parse_numbers,
    parse_rows,
    plain_lines,
    ragged_index,
)

COMMENT = re.compile(rb"#[^\n\r]*")
# Texture, colour and normal of a vertex follow its coordinates; a fourth coordinate (4) or any number (n) do not.
HEADER = re.compile(rb"\s*(?:ST)?C?N?(4?n?)(?:OFF|off)\s+(BINARY\s)?\s*(\d+)\s+(\d+)([^\n\r]*)")


def read_off(data: bytes, path: Path) -> PolygonMesh:
    """Vertices and polygons of an OFF file.

    Raises:
        MeshError: It holds less than its header says, is binary, or has vertices of other than three dimensions.
        ValueError: It is something else.
    """
    text = as_bytes(data)
    text = COMMENT.sub(b"", text) if b"#" in text else text
    header = HEADER.match(text)
    if header is None:
        raise ValueError("it does not begin with OFF and two counts")
    if header[1]:
        raise MeshError(f"{path} has vertices in {header[1].decode()} dimensions; three are needed")
    if header[2]:
        raise MeshError(f"{path} is a binary OFF file, which is not read: save it as text, or as PLY")
    vertex_count, face_count = int(header[3]), int(header[4])
    body = text[header.end() :]
    points, faces = _rows_by_kernel(body, vertex_count, face_count) or (None, None)
    if points is None or faces is None:
        lines = [line for line in body.splitlines() if line.strip()]
        if len(lines) < vertex_count + face_count:
            return _read_stream(b"\n".join(lines), vertex_count, face_count, len(lines), path)
        points = parse_rows(lines[:vertex_count])
        require_coordinates(path, points.lengths)
        faces = parse_rows(lines[vertex_count : vertex_count + face_count])
    require_coordinates(path, points.lengths)
    lengths = as_integers(faces.values[faces.starts])
    # What follows the corners is a colour.
    require_corners(path, faces.lengths - 1, lengths)
    if (lengths < 0).any():
        raise ValueError("a face has a negative number of corners")
    return PolygonMesh(points.columns(3), lengths, as_integers(faces.runs(1, lengths)))


def _rows_by_kernel(body: bytes, vertex_count: int, face_count: int) -> tuple[TextRows, TextRows] | None:
    """Numbers of the lines of vertices and faces; None where something is not plain, or there are not enough lines."""
    scanned = ScannedLines.of(plain_lines(body))
    if scanned is None:
        return None
    place = scanned.filled(vertex_count + face_count)
    if place is not None:
        begin, end = place
        points = scanned.rows_alike(slice(begin, begin + vertex_count))
        faces = scanned.rows_alike(slice(begin + vertex_count, end))
        if points is not None and faces is not None:
            return points, faces
    lines = scanned.not_blank()[: vertex_count + face_count]
    if len(lines) < vertex_count + face_count:
        return None
    points, faces = scanned.rows(lines[:vertex_count]), scanned.rows(lines[vertex_count:])
    return None if points is None or faces is None else (points, faces)


def _read_stream(text: bytes, vertex_count: int, face_count: int, lines: int, path: Path) -> PolygonMesh:
    """Vertices and faces that do not have a line each: then nothing but they may be there."""
    words = len(text.split())
    declared = vertex_count + face_count
    if words < 3 * vertex_count + face_count:
        require_count(path, lines, declared, "lines")
    values = parse_numbers(text, words)
    at = 3 * vertex_count
    lengths, starts = np.zeros(face_count, np.int64), np.zeros(face_count, np.int64)
    for face in range(face_count):
        length = int(values[at]) if at < words else -1
        if length < 0 or at + 1 + length > words:
            require_count(path, lines, declared, "lines")
        lengths[face], starts[face] = length, at + 1
        at += 1 + length
    if at != words:
        require_count(path, lines, declared, "lines")
    return PolygonMesh(
        values[: 3 * vertex_count].reshape(-1, 3), lengths, as_integers(values[ragged_index(starts, lengths)])
    )
