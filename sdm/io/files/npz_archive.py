"""NumPy archives, `.npz`, written by few large writes: the bytes of `numpy.savez`, without its hundred small calls."""

from __future__ import annotations

import io
import struct
import sys
from collections.abc import Mapping
from functools import lru_cache
from typing import IO, Any

import numpy as np
from isal import isal_zlib

from sdm.io.files.direct_file import DirectFile

# Bytes that are kept as they are, and not gathered with others.
LARGE = 1 << 16
# From here on a ZIP file has longer fields, which NumPy writes.
MOST_BYTES = (1 << 31) - 1
# ZIP: of version 4.5, stored, on 1 January 1980, made by Unix or Windows, to be read and written by its owner.
VERSION, STORED, TIME, DATE = 45, 0, 0, 0x21
SYSTEM = 0 if sys.platform == "win32" else 3
ATTRIBUTES = 0o600 << 16
LOCAL, CENTRAL, END = "<4s5H3I2H", "<4s4B4HL2L5H2L", "<4s4H2LH"
LATER = 0xFFFFFFFF


def write_archive(file: IO[bytes] | DirectFile, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays to a file as `numpy.savez` does, to the byte.

    `numpy.savez` copies each array, and seeks and writes some ten times for it. Each of these calls gives up Python's
    lock, and where fifteen threads write, waits to have it back longer than the disk takes.

    Args:
        file: Open for writing, at its begin.
        arrays: By their names in the archive.
    """
    if sum(array.nbytes + LARGE for array in arrays.values()) > MOST_BYTES:
        members: dict[str, Any] = dict(arrays)
        np.savez(file, **members)  # pyright: ignore[reportArgumentType]
        return
    pieces: list[bytearray | memoryview] = [bytearray()]
    central, at = bytearray(), 0
    for name, array in arrays.items():
        content = _member(array)
        size, checksum = sum(map(len, content)), 0
        for piece in content:
            checksum = isal_zlib.crc32(piece, checksum)
        file_name = f"{name}.npy".encode()
        flags = 0 if file_name.isascii() else 0x800
        extra = struct.pack("<HHQQ", 1, 16, size, size)
        head = (b"PK\x03\x04", VERSION, flags, STORED, TIME, DATE, checksum, LATER, LATER, len(file_name), len(extra))
        central += struct.pack(
            CENTRAL,
            *(b"PK\x01\x02", VERSION, SYSTEM, VERSION, 0, flags, STORED, TIME, DATE, checksum, size, size),
            *(len(file_name), 0, 0, 0, 0, ATTRIBUTES, at),
        )
        central += file_name
        _append(pieces, struct.pack(LOCAL, *head) + file_name + extra)
        for piece in content:
            _append(pieces, piece)
        at += struct.calcsize(LOCAL) + len(file_name) + len(extra) + size
    count = len(arrays)
    end = struct.pack(END, b"PK\x05\x06", 0, 0, count, count, len(central), at, 0)
    _append(pieces, bytes(central) + end)
    for piece in pieces:
        if len(piece):
            file.write(piece)


def _member(array: np.ndarray) -> list[bytes | memoryview]:
    """The pieces of an array's own file; large values are where the array has them."""
    if not array.flags.c_contiguous or array.dtype.hasobject:
        plain = io.BytesIO()
        np.lib.format.write_array(plain, array, allow_pickle=False)
        return [plain.getbuffer()]
    head = _head(array.dtype, array.shape)
    if array.nbytes < LARGE:
        return [head + array.tobytes()]
    return [head, array.reshape(-1).view(np.uint8).data]


@lru_cache(256)
def _head(dtype: np.dtype, shape: tuple[int, ...]) -> bytes:
    """Header of an array's own file."""
    plain = io.BytesIO()
    like = np.broadcast_to(np.zeros((), dtype), shape)
    about = {**np.lib.format.header_data_from_array_1_0(like), "fortran_order": False}
    np.lib.format.write_array_header_1_0(plain, about)
    return plain.getvalue()


def _append(pieces: list[bytearray | memoryview], piece: bytes | memoryview) -> None:
    """Small pieces are gathered, large ones kept by reference."""
    if len(piece) >= LARGE:
        pieces.append(memoryview(piece))
        return
    if isinstance(pieces[-1], memoryview):
        pieces.append(bytearray())
    pieces[-1] += piece  # type: ignore[operator]
