"""Rows of binary PLY elements: of one size where there are no lists, else found one after the other."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from sdm.io.meshes.damage import require_count
from sdm.io.meshes.ply_header import Element
from sdm.io.meshes.text_rows import ragged_index


def read_values(data: bytes, begin: int, element: Element, path: Path) -> tuple[np.ndarray, int]:
    """The rows of an element without lists, as a structured array, and where they end.

    Raises:
        MeshError: There are fewer than its header says.
    """
    row = np.dtype([(found.name, found.dtype) for found in element.properties])
    if row.itemsize == 0:
        return np.zeros(0, row), begin
    require_count(path, (len(data) - begin) // row.itemsize, element.count, _rows_of(element))
    return np.frombuffer(data, row, element.count, begin), begin + element.count * row.itemsize


def read_lists(
    data: bytes, begin: int, element: Element, wanted: str | None, path: Path
) -> tuple[np.ndarray | int, np.ndarray, int]:
    """Lengths (rows,) and entries of one list of an element that has lists, and where its rows end.

    Lengths are one number where they are all alike.

    Raises:
        MeshError: There are fewer rows than its header says.
        ValueError: A list has a negative length.
    """
    # A number of rows that the file has no space for would be memory first.
    require_count(path, len(data) - begin, element.count, _rows_of(element))
    return _read_alike(data, begin, element, wanted) or _read_ragged(data, begin, element, wanted, path)


def _read_alike(data: bytes, begin: int, element: Element, wanted: str | None) -> tuple[int, np.ndarray, int] | None:
    """The same where every row has lists as long as those of the first; None elsewhere."""
    fields: list[tuple[str, str] | tuple[str, str, int]] = []
    lengths: dict[str, int] = {}
    at = begin
    for number, found in enumerate(element.properties):
        value = np.dtype(found.dtype)
        if not found.count_dtype:
            fields.append((f"value {number}", found.dtype))
            at += value.itemsize
            continue
        count = np.dtype(found.count_dtype)
        if at + count.itemsize > len(data):
            return None
        length = int(np.frombuffer(data, count, 1, at)[0])
        at += count.itemsize + length * value.itemsize
        if length < 0 or at > len(data):
            return None
        fields += [(f"length {number}", found.count_dtype), (f"list {number}", found.dtype, length)]
        lengths[f"{number}"] = length
    row = np.dtype(fields)
    end = begin + element.count * row.itemsize
    if end > len(data):
        return None
    rows = np.frombuffer(data, row, element.count, begin)
    if any((rows[f"length {number}"] != length).any() for number, length in lengths.items()):
        return None
    number = next((n for n, found in enumerate(element.properties) if found.name == wanted), None)
    if number is None:
        return 0, np.zeros(0, np.int64), end
    return lengths[f"{number}"], rows[f"list {number}"].ravel(), end


def _read_ragged(
    data: bytes, begin: int, element: Element, wanted: str | None, path: Path
) -> tuple[np.ndarray, np.ndarray, int]:
    starts, lengths = np.zeros(element.count, np.int64), np.zeros(element.count, np.int64)
    steps = [_step(found.name == wanted, found.dtype, found.count_dtype) for found in element.properties]
    size = len(data)
    at = begin
    # Where a row begins is known from the row before alone.
    for row in range(element.count):
        for chosen, width, count_width, order, signed in steps:
            if not count_width:
                at += width
                continue
            length = int.from_bytes(data[at : at + count_width], order, signed=signed)
            if length < 0:
                raise ValueError(f"row {row} of {element.name} has a list of {length} values")
            at += count_width
            if chosen:
                starts[row], lengths[row] = at, length
            at += length * width
        if at > size:
            require_count(path, row, element.count, _rows_of(element))
    dtype = next((np.dtype(found.dtype) for found in element.properties if found.name == wanted), np.dtype("u1"))
    packed = np.frombuffer(data, np.uint8)[ragged_index(starts, lengths * dtype.itemsize)]
    return lengths, packed.view(dtype), at


def _step(chosen: bool, dtype: str, count_dtype: str) -> tuple[bool, int, int, Literal["big", "little"], bool]:
    """Layout of a property in a row: True for the wanted one, bytes of a value and of a length, the length's type."""
    width = np.dtype(dtype).itemsize
    if not count_dtype:
        return chosen, width, 0, "little", False
    count = np.dtype(count_dtype)
    return chosen, width, count.itemsize, "big" if count_dtype[0] == ">" else "little", count.kind == "i"


def _rows_of(element: Element) -> str:
    return "faces" if element.name == "face" else "vertices" if element.name == "vertex" else f"rows of {element.name}"
