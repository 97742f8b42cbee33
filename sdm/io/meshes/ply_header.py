"""Headers of PLY files: elements, and the properties of each."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

HEADER = re.compile(rb"ply\s.*?end_header[^\n\r]*(?:\r\n|\n|\r)", re.DOTALL)
ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4"}
TYPES |= {"uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8"}
# The list of a face's corners.
CORNERS = ("vertex_index", "vertex_indices")


@dataclass(frozen=True)
class Property:
    """A property of an element: one value, or a list of them.

    Args:
        name: As the header has it.
        dtype: NumPy's name of a value's type, with its byte order.
        count_dtype: Of the number of values, for lists; empty for one value.
    """

    name: str
    dtype: str
    count_dtype: str = ""


@dataclass(frozen=True)
class Element:
    """An element of the header: its name, how many rows it has, and what is in each."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    def corners(self) -> str:
        """The name of the list of a face's corners.

        Raises:
            ValueError: There is none.
        """
        lists = [found.name for found in self.properties if found.count_dtype]
        name = next((name for name in lists if name in CORNERS), lists[0] if len(lists) == 1 else None)
        if name is None:
            raise ValueError("its faces have no list called vertex_indices")
        return name


@dataclass(frozen=True)
class PlyHeader:
    """Header of a PLY file.

    Args:
        ascii: Whether numbers are text.
        elements: In the order of the file.
        end: Where in the file the values begin.
    """

    ascii: bool
    elements: list[Element]
    end: int


def parse_header(data: bytes) -> PlyHeader:
    """The header of a PLY file.

    Raises:
        ValueError: There is none, or it is damaged.
    """
    found = HEADER.match(data)
    if found is None:
        raise ValueError("it has no PLY header")
    lines = [line.split() for line in found[0].decode("latin-1").splitlines()]
    encodings = [words[1] for words in lines if words[:1] == ["format"] and len(words) > 1]
    if not encodings or encodings[0] not in ORDERS:
        raise ValueError(f"its format is {' '.join(encodings) or 'not given'}")
    order = ORDERS[encodings[0]]
    elements: list[Element] = []
    for words in lines:
        if words[:1] == ["element"]:
            elements.append(Element(words[1], int(words[2])))
            if elements[-1].count < 0:
                raise ValueError(f"it has {words[2]} rows of {words[1]}")
        elif words[:2] == ["property", "list"]:
            count = _dtype(words[2], order)
            if np.dtype(count).kind == "f":
                raise ValueError(f"the length of a list is a {words[2]}")
            elements[-1].properties.append(Property(words[4], _dtype(words[3], order), count))
        elif words[:1] == ["property"]:
            elements[-1].properties.append(Property(words[2], _dtype(words[1], order)))
    return PlyHeader(order == "=", elements, found.end())


def _dtype(name: str, order: str) -> str:
    if name not in TYPES:
        raise ValueError(f"{name[:40]} is no type of a property")
    return order + TYPES[name]
