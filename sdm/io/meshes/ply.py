"""PLY files: vertices and faces, of text and binary ones of either byte order."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from sdm.errors import MeshError
from sdm.io.meshes.damage import require_coordinates, require_corners, require_count
from sdm.io.meshes.ply_binary import read_lists, read_values
from sdm.io.meshes.ply_header import Element, PlyHeader, parse_header
from sdm.io.meshes.polygons import PolygonMesh
from sdm.io.meshes.text_rows import ScannedLines, TextRows, as_integers, parse_rows, plain_lines, ragged_index

NEEDED = ("vertex", "face")
STRIPS = "tristrips"


def read_ply(data: bytes, path: Path) -> PolygonMesh:
    """Vertices and polygons of a PLY file; one without faces has none.

    Raises:
        MeshError: It holds less than its header says, or triangles as strips.
        ValueError: It is damaged, or something else.
    """
    header = parse_header(data)
    counts = {element.name: element.count for element in header.elements}
    if counts.get(STRIPS):
        raise MeshError(f"{path} has strips of triangles, which are not read: save it with faces")
    if not counts.get("face"):
        return PolygonMesh.of_triangles(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    if "vertex" not in counts:
        raise ValueError("it has faces and no vertices")
    return _read_text(data, header, path) if header.ascii else _read_binary(data, header, path)


def _read_binary(data: bytes, header: PlyHeader, path: Path) -> PolygonMesh:
    at, points, corners = header.end, np.zeros((0, 3)), np.zeros(0, np.int64)
    lengths: np.ndarray | int = 3
    left = set(NEEDED)
    for element in header.elements:
        if not left:
            break
        left.discard(element.name)
        if element.name == "face":
            lengths, corners, at = read_lists(data, at, element, element.corners(), path)
        elif any(found.count_dtype for found in element.properties):
            if element.name == "vertex":
                raise ValueError("its vertices have lists")
            at = read_lists(data, at, element, None, path)[2]
        else:
            values, at = read_values(data, at, element, path)
            if element.name == "vertex":
                points = _points(values)
    # int32 of this machine's byte order is what a mesh has.
    return PolygonMesh(points, lengths, corners if corners.dtype == np.int32 else as_integers(corners))


def _points(values: np.ndarray) -> np.ndarray:
    """Coordinates (V,3) of rows with x, y and z among others, float64, or float32 where these are."""
    axes = [values[axis] for axis in "xyz"]
    if all(axis.dtype == np.float32 for axis in axes):
        points = np.empty((len(values), 3), np.float32)
        for number, axis in enumerate(axes):
            points[:, number] = axis
        return points
    return np.column_stack(axes).astype(np.float64)


def _read_text(data: bytes, header: PlyHeader, path: Path) -> PolygonMesh:
    scanned = ScannedLines.of(plain_lines(data[header.end :]))
    if scanned is not None:
        try:
            return _of_rows(lambda begin, end: _parsed(scanned, begin, end), len(scanned.not_blank()), header, path)
        except NotPlainError:
            pass
    lines = [line for line in data[header.end :].splitlines() if line.strip()]
    return _of_rows(lambda begin, end: parse_rows(lines[begin:end]), len(lines), header, path)


class NotPlainError(Exception):
    """A text that has to be read word by word."""


def _parsed(scanned: ScannedLines, begin: int, end: int) -> TextRows:
    rows = scanned.rows(scanned.not_blank()[begin:end])
    if rows is None:
        raise NotPlainError
    return rows


def _of_rows(rows_of: Callable[[int, int], TextRows], count: int, header: PlyHeader, path: Path) -> PolygonMesh:
    """The mesh of the rows that begin and end at lines of a text with `count` of them."""
    require_count(path, count, sum(element.count for element in header.elements), "lines")
    points, lengths, corners = np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64)
    begin = 0
    for element in header.elements:
        begin, first = begin + element.count, begin
        if element.name == "vertex":
            if any(found.count_dtype for found in element.properties):
                raise ValueError("its vertices have lists")
            rows = rows_of(first, begin)
            names = [found.name for found in element.properties]
            require_coordinates(path, rows.lengths, len(names))
            points = rows.columns(len(names))[:, [names.index(axis) for axis in "xyz"]]
        elif element.name == "face":
            lengths, corners = _lists_of_text(rows_of(first, begin), element, path)
    return PolygonMesh(points, lengths, corners)


def _lists_of_text(rows: TextRows, element: Element, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (F,) and entries of the faces' corners, from their lines."""
    wanted = element.corners()
    at, ends = rows.starts.copy(), rows.starts + rows.lengths
    found = np.zeros(0, np.int64), np.zeros(0, np.int64)
    for kept in element.properties:
        _require_row(path, at, ends, np.ones_like(at))
        if not kept.count_dtype:
            at += 1
            continue
        lengths = as_integers(rows.values[at])
        if (lengths < 0).any():
            raise ValueError("a face has a negative number of corners")
        _require_row(path, at + 1, ends, lengths)
        if kept.name == wanted:
            found = lengths, as_integers(rows.values[ragged_index(at + 1, lengths)])
        at += 1 + lengths
    return found


def _require_row(path: Path, at: np.ndarray, ends: np.ndarray, needed: np.ndarray) -> None:
    require_corners(path, ends - at, needed)
