"""Values of an NRRD file: no more of them than its header declares, and from nowhere but beside it."""

from __future__ import annotations

import bz2
import math
import re
import zlib
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import IO, Any

import nrrd
import numpy as np

from sdm.errors import FormatError

BLOCK = 1 << 20
# Of a header with a list of files, which pynrrd does not know.
LIST, LONGEST_HEADER = re.compile(rb"^data ?file: *LIST\b", re.IGNORECASE | re.MULTILINE), 1 << 14
SEVERAL = "has its values in several files, which are not read: join them into one"
GZIP, BZIP2 = ("gzip", "gz"), ("bzip2", "bz2")
# Bytes of the widest type of a voxel, and of what may be skipped before the first one.
WIDEST, LONGEST_SKIP = 8, 1 << 20


def read_header(path: Path) -> Any:
    """The header of an NRRD file, whose values lie in it or in one other file.

    Raises:
        FormatError: It names a list of files.
    """
    with path.open("rb") as file:
        if LIST.search(file.read(LONGEST_HEADER)):
            raise FormatError(f"{path} {SEVERAL}")
    return nrrd.read_header(str(path))


def read_values(file: IO[bytes], header: Any, path: Path) -> np.ndarray:
    """Values (nx,ny,nz) of a header that was read from `file`, which stands behind it.

    Raises:
        FormatError: They lie elsewhere in the file system, or in several files, or unpack to more than the header
            declares.
    """
    beside = header.get("datafile", header.get("data file"))
    if beside is None:
        return _decode(file, header, path)
    if "%" in str(beside):
        raise FormatError(f"{path} {SEVERAL}")
    name = PurePosixPath(str(beside))
    if name.is_absolute() or ".." in name.parts:
        raise FormatError(f"{path} has its values in {str(beside)[:100]!r}: only files beside it are read")
    attached = {key: value for key, value in header.items() if key not in ("datafile", "data file")}
    with (path.parent / name).open("rb") as other:
        return _decode(other, attached, path)


def _decode(file: IO[bytes], header: Any, path: Path) -> np.ndarray:
    encoding = header["encoding"]
    if encoding not in (*GZIP, *BZIP2):
        return nrrd.read_data(header, file, str(path), index_order="F")
    for _ in range(int(header.get("lineskip", header.get("line skip", 0)))):
        file.readline()
    skipped = int(header.get("byteskip", header.get("byte skip", 0)))
    limit = WIDEST * math.prod(int(n) for n in header["sizes"]) + min(max(skipped, 0), LONGEST_SKIP)
    values = _unpack_gzip(file, limit) if encoding in GZIP else _unpack_bzip2(file, limit)
    if len(values) > limit:
        raise FormatError(f"{path} is damaged: its values unpack to more than the voxels that its header declares")
    plain = {key: value for key, value in header.items() if key not in ("lineskip", "line skip")}
    return nrrd.read_data({**plain, "encoding": "raw"}, BytesIO(values), str(path), index_order="F")


def _unpack_gzip(file: IO[bytes], limit: int) -> bytes:
    """The first `limit` bytes of what is packed, and one more where there are more."""
    unpacker, found = zlib.decompressobj(zlib.MAX_WBITS | 16), bytearray()
    # To the end, where its checksum is.
    while not unpacker.eof and len(found) <= limit:
        packed = unpacker.unconsumed_tail or file.read(BLOCK)
        if not packed:
            break
        found += unpacker.decompress(packed, limit + 1 - len(found))
    return bytes(found)


def _unpack_bzip2(file: IO[bytes], limit: int) -> bytes:
    unpacker, found = bz2.BZ2Decompressor(), bytearray()
    while not unpacker.eof and len(found) <= limit:
        packed = file.read(BLOCK) if unpacker.needs_input else b""
        if not packed and unpacker.needs_input:
            break
        found += unpacker.decompress(packed, limit + 1 - len(found))
    return bytes(found)
