"""STL files, binary and text: three corners of each triangle."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from sdm.errors import MeshError
from sdm.io.meshes.damage import require_count
from sdm.io.meshes.polygons import PolygonMesh
from sdm.io.meshes.text_rows import parse_numbers

HEADER = 84
FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
NAME = re.compile(rb"^[ \t]*(?:end)?solid[^\n\r]*", re.MULTILINE | re.IGNORECASE)
FACET = re.compile(rb"(?<!\S)facet(?!\S)", re.IGNORECASE)
VERTEX = re.compile(rb"(?<!\S)vertex\s+(\S+\s+\S+\s+\S+)", re.IGNORECASE)


def read_stl(data: bytes, path: Path) -> PolygonMesh:
    """Triangles of an STL file, of whichever kind it is.

    Raises:
        MeshError: It holds less than it says, or a binary file more.
        ValueError: It is something else.
    """
    declared = int.from_bytes(data[HEADER - 4 : HEADER], "little")
    if len(data) >= HEADER and len(data) == HEADER + FACE.itemsize * declared:
        corners = np.frombuffer(data, FACE, declared, HEADER)["corners"]
        return _soup(corners.reshape(-1, 3))
    # Some programs begin binary files with this word too.
    if data.lstrip()[:5].lower() == b"solid":
        return _read_text(data, path)
    if len(data) < HEADER:
        raise ValueError("it is neither text that begins with solid, nor long enough for a binary file")
    require_count(path, (len(data) - HEADER) // FACE.itemsize, declared, "triangles")
    raise MeshError(f"{path} is damaged: its header promises {declared} triangles, and more than these are there")


def _read_text(data: bytes, path: Path) -> PolygonMesh:
    if b"endsolid" not in data[-1000:].lower():
        raise MeshError(f"{path} is cut off: it does not end with endsolid")
    text = NAME.sub(b"", data)
    facets, corners = len(FACET.findall(text)), VERTEX.findall(text)
    if len(corners) != 3 * facets:
        raise MeshError(f"{path} is cut off or damaged: it has {facets} facets, and {len(corners)} corners of them")
    return _soup(parse_numbers(b"\n".join(corners), 3 * len(corners)).reshape(-1, 3))


def _soup(corners: np.ndarray) -> PolygonMesh:
    return PolygonMesh.of_triangles(corners, np.arange(len(corners)).reshape(-1, 3))
