"""Binary PLY files whose faces have several numbers of corners: trimesh reads those of one number alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sdm.io.meshes.check_truncated import PLY_HEADER
from sdm.io.meshes.ear_clipping import cut, find_wrong_fans
from sdm.io.meshes.polygons import PLY_NAMES

ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
# The older names; the others are NumPy's.
C_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
C_TYPES |= {"float": "f4", "double": "f8"}


@dataclass
class Element:
    """An element of the header: its rows, its properties of one value, and its list, if there is one.

    Args:
        name: As the header has it.
        count: How many rows.
        values: Name and type of each property of one value, in order.
        lists: Name, type of the number of entries and type of an entry of each list, and how many of `values` are
            before it.
    """

    name: str
    count: int
    values: list[tuple[str, str]] = field(default_factory=list)
    lists: list[tuple[str, str, str, int]] = field(default_factory=list)


def read_mixed(data: bytes) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices (V,3) float64 and triangles (F,3) int64 of a binary PLY file whose faces differ in corners.

    None for every other file, and for one with anything odd, such as a second list beside the faces' corners, which is
    for trimesh to read or to refuse.

    Raises:
        IndexError: A face uses a vertex that is not there.
    """
    try:
        found = _parsed(data)
    except (ValueError, IndexError, KeyError, TypeError, OverflowError, StopIteration):
        return None
    if found is None:
        return None
    vertices, polygons = found
    return vertices, _triangles(vertices, polygons)


def _parsed(data: bytes) -> tuple[np.ndarray, list[np.ndarray]] | None:
    header = PLY_HEADER.match(data)
    if header is None:
        return None
    lines = [line.split() for line in header[0].decode("latin-1").splitlines()]
    order = next(ORDERS.get(words[1]) for words in lines if words[:1] == ["format"])
    if order is None:
        return None
    elements = _elements(lines, order)
    before = elements[: [element.name for element in elements].index("face")]
    face = elements[len(before)]
    if [name for name, *_ in face.lists] not in [[name] for name in PLY_NAMES] or any(e.lists for e in before):
        return None
    at, vertices = header.end(), None
    for element in before:
        rows = np.frombuffer(data, np.dtype(element.values), element.count, at)
        at += rows.nbytes
        vertices = rows if element.name == "vertex" else vertices
    # A number of faces that the file has no room for would be memory first.
    if vertices is None or not 0 < face.count <= len(data) or _all_alike(data, at, face):
        return None
    starts, counts = _rows(data, at, face, order)
    points = np.column_stack([vertices[axis] for axis in "xyz"]).astype(np.float64)
    return points, _polygons(data, starts, counts, np.dtype(face.lists[0][2]))


def _elements(lines: Sequence[Sequence[str]], order: str) -> list[Element]:
    found: list[Element] = []
    for words in lines:
        if words[:1] == ["element"]:
            found.append(Element(words[1], int(words[2])))
        elif words[:2] == ["property", "list"]:
            found[-1].lists.append((words[4], _type(words[2], order), _type(words[3], order), len(found[-1].values)))
        elif words[:1] == ["property"]:
            found[-1].values.append((words[2], _type(words[1], order)))
    return found


def _type(name: str, order: str) -> str:
    return order + np.dtype(C_TYPES.get(name, name)).str[1:]


def _all_alike(data: bytes, begin: int, face: Element) -> bool:
    """Whether all faces have as many corners as the first, so that there is nothing to do here."""
    _, size, entry, values_before = face.lists[0]
    first = begin + np.dtype(face.values[:values_before]).itemsize
    count = int(np.frombuffer(data, size, 1, first)[0])
    row = [*face.values[:values_before], ("count", size), ("corners", entry, count), *face.values[values_before:]]
    room = (len(data) - begin) // np.dtype(row).itemsize
    return room >= face.count and bool((np.frombuffer(data, row, face.count, begin)["count"] == count).all())


def _rows(data: bytes, begin: int, face: Element, order: str) -> tuple[np.ndarray, np.ndarray]:
    """Where the corners of each face begin, and how many there are."""
    _, size_type, entry_type, values_before = face.lists[0]
    before = np.dtype(face.values[:values_before]).itemsize
    wide, entry = np.dtype(size_type).itemsize, np.dtype(entry_type).itemsize
    rest = np.dtype(face.values).itemsize - before
    word = "little" if order == "<" else "big"
    starts, counts = np.empty(face.count, np.int64), np.empty(face.count, np.int64)
    end = begin
    # Where a row begins is known from the row before alone.
    for row in range(face.count):
        start = end + before + wide
        count = int.from_bytes(data[start - wide : start], word)
        starts[row], counts[row] = start, count
        end = start + count * entry + rest
    if end > len(data):
        raise ValueError("the file is cut off")
    return starts, counts


def _polygons(data: bytes, starts: np.ndarray, counts: np.ndarray, entry: np.dtype) -> list[np.ndarray]:
    everything = np.frombuffer(data, np.uint8)
    found: list[np.ndarray] = [np.empty(0, np.int64)] * len(starts)
    for count in np.unique(counts):
        own = np.flatnonzero(counts == count)
        packed = everything[starts[own, None] + np.arange(count * entry.itemsize)]
        for number, corners in zip(own.tolist(), packed.view(entry).astype(np.int64), strict=True):
            found[number] = corners
    return found


def _triangles(vertices: np.ndarray, polygons: list[np.ndarray]) -> np.ndarray:
    """(F,3), in the order of the faces; a face of fewer than three corners has none."""
    wrong = find_wrong_fans(vertices, polygons)
    lengths = np.array([len(polygon) for polygon in polygons])
    fans = lengths.copy()
    fans[wrong] = 0
    triangles, owners = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    for number in wrong:
        triangles.append(polygons[number][cut(vertices[polygons[number]])])
        owners.append(np.full(lengths[number] - 2, number))
    for length in np.unique(fans[fans >= 3]):
        own = np.flatnonzero(fans == length)
        corners = np.stack([polygons[number] for number in own.tolist()])
        steps = np.arange(1, length - 1)
        triangles.append(corners[:, np.stack([0 * steps, steps, steps + 1], 1)].reshape(-1, 3))
        owners.append(np.repeat(own, length - 2))
    return np.concatenate(triangles)[np.argsort(np.concatenate(owners), kind="stable")]
