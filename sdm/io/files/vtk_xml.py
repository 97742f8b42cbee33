"""Arrays in VTK's XML files (`.vti`, `.vtp`): written as they are, read in each of the ways that VTK writes them."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, BinaryIO, TypeAlias

import numpy as np

from sdm.errors import one_line

if TYPE_CHECKING:
    from xml.etree import ElementTree as ET

TYPES = {
    "Int8": "i1",
    "UInt8": "u1",
    "Int16": "i2",
    "UInt16": "u2",
    "Int32": "i4",
    "UInt32": "u4",
    "Int64": "i8",
    "UInt64": "u8",
    "Float32": "f4",
    "Float64": "f8",
    # Its codes, a zero behind each text.
    "String": "u1",
}
APPENDED = b"<AppendedData"
Bytes: TypeAlias = bytes | memoryview


class VtkFile:
    """A file's elements, `root`, and the values of its arrays.

    Raises:
        ValueError: It is no such file, of another kind than `kind`, or damaged.
    """

    def __init__(self, data: bytes, kind: str) -> None:
        # A parser that commands without such files need not wait for.
        from xml.etree import ElementTree as ET

        marker = data.find(APPENDED)
        try:
            # Not to be found among values: no bytes of XML are read behind the marker.
            self.root = ET.fromstring(data if marker < 0 else data[:marker] + b"</VTKFile>")  # noqa: S314 (plain elements)
        except ET.ParseError as error:
            raise ValueError(f"it is no XML: {one_line(error)}") from error
        if self.root.tag != "VTKFile" or self.root.get("type") != kind:
            raise ValueError(f"it is no VTK file of type {kind}")
        if self.root.get("compressor") not in (None, "vtkZLibDataCompressor"):
            raise ValueError(f"it is compressed by {self.root.get('compressor')}, which is not read: use zlib or none")
        self._order = ">" if self.root.get("byte_order") == "BigEndian" else "<"
        self._counter = np.dtype(self._order + TYPES[self.root.get("header_type", "UInt32")])
        self._is_text, self._appended = False, memoryview(b"")
        if marker >= 0:
            begin = marker + len(APPENDED)
            self._is_text = b'encoding="base64"' in data[begin : begin + 200]
            # Parts of it are looked at, not copied.
            self._appended = memoryview(data)[data.index(b"_", begin) + 1 :]

    def values(self, array: ET.Element) -> np.ndarray:
        """The numbers (N,) or (N,components) of a DataArray."""
        name = array.get("type", "")
        if name not in TYPES:
            raise ValueError(f"it has an array of type {name[:40]}")
        dtype = np.dtype(self._order + TYPES[name])
        found = self._flat(array, dtype)
        components = int(array.get("NumberOfComponents", "1"))
        return found if components == 1 else found.reshape(-1, components)

    def _flat(self, array: ET.Element, dtype: np.dtype) -> np.ndarray:
        kind = array.get("format", "ascii")
        if kind == "ascii":
            return np.array((array.text or "").split(), dtype=dtype)
        data: Bytes
        if kind == "appended":
            begin = int(array.get("offset", "0"))
            data, is_text = self._appended[begin:], self._is_text
        else:
            data, is_text = (array.text or "").strip().encode(), True
        return np.frombuffer(self._unpacked(data, is_text), dtype)

    def _unpacked(self, data: Bytes, is_text: bool) -> Bytes:
        if self.root.get("compressor") is None:
            head, body = self._split(data, 1, is_text)
            return _whole(body(int(head[0])), int(head[0]))
        count = int(self._split(data, 1, is_text)[0][0])
        if count == 0:
            return b""
        # Blocks, their bytes when unpacked, those of the last if it is shorter, and the packed bytes of each.
        head, body = self._split(data, 3 + count, is_text)
        size, last, packed = int(head[1]), int(head[2]) or int(head[1]), head[3:].astype(np.int64)
        joined, blocks, begin = _whole(body(int(packed.sum())), int(packed.sum())), [], 0
        for number, length in enumerate(packed.tolist()):
            wanted = last if number == count - 1 else size
            # One byte more than is wanted, so that the stream's end is reached, where its checksum is.
            unpacker = zlib.decompressobj()
            unpacked = unpacker.decompress(joined[begin : begin + length], wanted + 1)
            if len(unpacked) > wanted or (len(unpacked) == wanted and not unpacker.eof):
                raise ValueError(f"block {number} of an array unpacks to other than the {wanted} bytes it declares")
            blocks.append(_whole(unpacked, wanted))
            begin += length
        return b"".join(blocks)

    def _split(self, data: Bytes, counters: int, is_text: bool) -> tuple[np.ndarray, Callable[[int], Bytes]]:
        """The counters before an array, and a function that gives so many bytes of what follows."""
        size = counters * self._counter.itemsize
        if not is_text:
            return np.frombuffer(_whole(data[:size], size), self._counter), lambda more: data[size : size + more]
        if self.root.get("compressor") is None:
            # One text for both.
            return (
                np.frombuffer(_whole(_decoded(data, size)[:size], size), self._counter),
                lambda more: _decoded(data, size + more)[size : size + more],
            )
        text = -(-size // 3) * 4
        return (
            np.frombuffer(_whole(_decoded(data, size)[:size], size), self._counter),
            lambda more: _decoded(data[text:], more)[:more],
        )


def _decoded(text: Bytes, size: int) -> bytes:
    return base64.b64decode(text[: -(-size // 3) * 4])


def _whole(data: Bytes, size: int) -> Bytes:
    if len(data) < size:
        raise ValueError("it is cut off")
    return data


def data_array(name: str, values: np.ndarray, offset: int) -> str:
    """The element of an array whose values are appended, so many bytes after the first array's."""
    kind = next(known for known, code in TYPES.items() if np.dtype(code) == values.dtype)
    components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    return f'<DataArray type="{kind}" Name="{name}"{components} format="appended" offset="{offset}"/>\n'


def offsets_of(arrays: Iterable[np.ndarray]) -> list[int]:
    """Offsets of arrays, in bytes after the first."""
    found = [0]
    for values in arrays:
        found.append(found[-1] + 8 + values.nbytes)
    return found[:-1]


def write_file(file: BinaryIO, kind: str, inside: str, arrays: Iterable[np.ndarray]) -> None:
    """Write a whole file: elements, then the values of little-endian arrays, not compressed."""
    head = (
        f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="1.0" byte_order="LittleEndian" '
        f'header_type="UInt64">\n{inside}<AppendedData encoding="raw">\n_'
    )
    file.write(head.encode())
    for values in arrays:
        file.write(values.nbytes.to_bytes(8, "little"))
        file.write(np.ascontiguousarray(values).data)
    file.write(b"\n</AppendedData>\n</VTKFile>\n")
