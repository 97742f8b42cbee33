"""`.vtk`, VTK's legacy files of surfaces: text or big-endian numbers, in versions 1 to 5."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from sdm.errors import MeshError
from sdm.io.meshes.polygons import PolygonMesh
from sdm.io.meshes.text_rows import parse_numbers, ragged_index

HEADER = re.compile(rb"# vtk DataFile Version (\d+)\.\d+[^\n]*\n[^\n]*\n\s*(ASCII|BINARY)\s+DATASET\s+(\w+)\s+")
TYPES = {
    b"char": "i1",
    b"unsigned_char": "u1",
    b"short": "i2",
    b"unsigned_short": "u2",
    b"int": "i4",
    b"unsigned_int": "u4",
    b"long": "i8",
    b"unsigned_long": "u8",
    b"float": "f4",
    b"double": "f8",
    b"vtktypeint64": "i8",
    b"vtktypeint32": "i4",
}
WORD = re.compile(rb"\S+")
# Cells of unstructured grids that are polygons: triangles, polygons, quads. Those that have no area are left out.
POLYGONS, FLAT = (5, 7, 9), (0, 1, 2, 3, 4)
# What a surface has besides polygons.
LEFT_OUT = ("VERTICES", "LINES")


class _Reader:
    """A file's numbers one after the other."""

    def __init__(self, data: bytes, begin: int, is_text: bool) -> None:
        self.data, self.at, self.is_text = data, begin, is_text

    def word(self) -> bytes:
        """The next word; none at the end."""
        found = WORD.search(self.data, self.at)
        if found is None:
            return b""
        self.at = found.end()
        return found[0]

    def numbers(self, count: int, kind: str) -> np.ndarray:
        if count < 0:
            raise ValueError("a count is negative")
        if self.is_text:
            begin = self.at
            for _ in range(count):
                if not self.word():
                    raise ValueError("it is cut off")
            return parse_numbers(self.data[begin : self.at], count)
        # The line ends before.
        begin = self.data.index(b"\n", self.at) + 1
        self.at = begin + count * np.dtype(kind).itemsize
        if self.at > len(self.data):
            raise ValueError("it is cut off")
        return np.frombuffer(self.data[begin : self.at], ">" + kind)

    def whole_numbers(self, count: int, kind: str = "i4") -> np.ndarray:
        return self.numbers(count, kind).astype(np.int64)

    def cells(self, version: int) -> tuple[np.ndarray, np.ndarray]:
        """Lengths and corners of cells."""
        first, second = int(self.word()), int(self.word())
        if version < 5:
            return _counted(self.whole_numbers(second), first)
        ends = self._array(b"OFFSETS", first)
        corners = self._array(b"CONNECTIVITY", second)
        return np.diff(ends), corners

    def _array(self, name: bytes, count: int) -> np.ndarray:
        if self.word() != name:
            raise ValueError(f"it has no {name.decode()}")
        return self.whole_numbers(count, _type(self.word()))


def read_vtk(data: bytes, path: Path) -> PolygonMesh:
    """Points and polygons of a `.vtk` file of polygonal data or of an unstructured grid of polygons.

    Raises:
        MeshError: It has volume cells or strips, or is another kind of data set.
        ValueError: It is something else, or damaged.
    """
    header = HEADER.match(data)
    if header is None:
        raise ValueError("it does not begin as a VTK file")
    version, kind = int(header[1]), header[3].decode()
    if kind not in ("POLYDATA", "UNSTRUCTURED_GRID"):
        raise MeshError(f"{path} has a {kind[:40]}, not a surface: save polygonal data")
    sections = _sections(_Reader(data, header.end(), header[2] == b"ASCII"), version, path)
    lengths, corners = sections.get("CELLS", (np.zeros(0, np.int64), np.zeros(0, np.int64)))
    if kind == "UNSTRUCTURED_GRID":
        lengths, corners = _polygons_of(lengths, corners, sections.get("CELL_TYPES"), path)
    if lengths.sum() != len(corners) or (lengths < 0).any():
        raise ValueError("its polygons do not use up their corners")
    return PolygonMesh(sections.get("POINTS", np.zeros((0, 3))), lengths, corners)


def _sections(reader: _Reader, version: int, path: Path) -> dict[str, Any]:
    """Points, cells (also under that name those of POLYGONS) and their types."""
    found: dict[str, Any] = {}
    while word := reader.word().decode("latin-1"):
        if word == "POINTS":
            count = int(reader.word())
            places = reader.numbers(3 * count, _type(reader.word()))
            found[word] = places.reshape(-1, 3).astype(np.float64)
        elif word in ("POLYGONS", "CELLS"):
            found["CELLS"] = reader.cells(version)
        elif word == "CELL_TYPES":
            found[word] = reader.whole_numbers(int(reader.word()))
        elif word in LEFT_OUT:
            reader.cells(version)
        elif word == "TRIANGLE_STRIPS":
            raise MeshError(
                f"{path} has triangle strips, which are not read: save it with polygons (vtkTriangleFilter)"
            )
        elif word == "METADATA":
            reader.at = max(reader.data.find(b"\n\n", reader.at), reader.at)
        elif word in ("POINT_DATA", "CELL_DATA", "FIELD"):
            break
        else:
            raise ValueError(f"it has {word[:40]!r} where a section begins")
    return found


def _counted(values: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cells whose corners follow their number."""
    if not count:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    # Before a count that is damaged becomes an array of that size.
    if not 0 < count <= len(values):
        raise ValueError("its polygons do not use up their corners")
    if len(values) % count == 0 and (values[:: len(values) // count] == len(values) // count - 1).all():
        rows = values.reshape(count, -1)
        return rows[:, 0], rows[:, 1:].ravel()
    starts = np.zeros(count, np.int64)
    at = 0
    for number in range(count):
        if at >= len(values) or values[at] < 0:
            raise ValueError("its polygons do not use up their corners")
        starts[number] = at
        at += 1 + int(values[at])
    if at != len(values):
        raise ValueError("its polygons do not use up their corners")
    lengths = values[starts]
    return lengths, values[ragged_index(starts + 1, lengths)]


def _polygons_of(
    lengths: np.ndarray, corners: np.ndarray, types: np.ndarray | None, path: Path
) -> tuple[np.ndarray, np.ndarray]:
    """The polygons of an unstructured grid."""
    if types is None or len(types) != len(lengths):
        raise ValueError("its cells have no types")
    wrong = ~np.isin(types, (*POLYGONS, *FLAT))
    if wrong.any():
        raise MeshError(f"{path} has volume cells or strips (type {int(types[wrong][0])}): extract its surface first")
    kept = np.isin(types, POLYGONS)
    starts = np.cumsum(lengths) - lengths
    return lengths[kept], corners[ragged_index(starts[kept], lengths[kept])]


def _type(name: bytes) -> str:
    if name.lower() not in TYPES:
        raise ValueError(f"it has numbers of type {name[:40]!r}")
    return TYPES[name.lower()]


def write_vtk(vertices: np.ndarray, faces: np.ndarray, file: BinaryIO) -> None:
    """Write vertices (V,3) and faces (F,3) as a legacy file, in binary, of version 3.0, which every VTK reads."""
    file.write(b"# vtk DataFile Version 3.0\nsdm\nBINARY\nDATASET POLYDATA\n")
    file.write(f"POINTS {len(vertices)} float\n".encode() + vertices.astype(">f4").tobytes())
    rows = np.insert(faces.astype(">i4"), 0, 3, axis=1)
    file.write(f"\nPOLYGONS {len(faces)} {rows.size}\n".encode() + rows.tobytes() + b"\n")
