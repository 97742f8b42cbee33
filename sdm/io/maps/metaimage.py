"""MetaImage files (`.mha`, `.mhd`), ITK's own format, whose coordinates are left-posterior-superior.

Both are written as one file, header and values; ITK reads an `.mhd` of that kind too.
"""

from __future__ import annotations

import json
import zlib
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import torch

from sdm.core.as_grid import LPS
from sdm.core.axis_order import reversed_axes
from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError
from sdm.io.maps.check_dtype import plain_numbers
from sdm.io.maps.header_record import geometry_of
from sdm.io.maps.record import KEY, RECORD_CHECKSUM, record, sign_arguments, signs_of, to_line, verify, with_checksum

# Headers are text and much shorter; values may follow in the same file.
LONGEST_HEADER = 1 << 16
# The last line of a header.
END = "ElementDataFile"
# Names of a field of the geometry, of which the first is ours.
TURN = ("TransformMatrix", "Rotation", "Orientation")
SPACING = ("ElementSpacing", "ElementSize")
ORIGIN = ("Offset", "Position", "Origin")
TYPES = {
    "MET_CHAR": "i1",
    "MET_UCHAR": "u1",
    "MET_SHORT": "i2",
    "MET_USHORT": "u2",
    "MET_INT": "i4",
    "MET_UINT": "u4",
    "MET_LONG": "i4",
    "MET_ULONG": "u4",
    "MET_LONG_LONG": "i8",
    "MET_ULONG_LONG": "u8",
    "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}


def write(field: SDM, path: Path, made_from: str | None = None) -> None:
    """Write a map, not compressed: distances hardly shrink."""
    grid, values = field.grid, field.numpy().astype("<f4", copy=False)
    kept = with_checksum(record(grid, field.ambiguous_voxels, made_from, signs_of(field)), values)
    turned = LPS @ grid.affine + 0.0
    header = {
        "ObjectType": "Image",
        "NDims": "3",
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "CompressedData": "False",
        # One row of the file for each axis of the image.
        "TransformMatrix": _line((turned[:3, :3] / grid.spacing).T.ravel()),
        "Offset": _line(turned[:3, 3]),
        "CenterOfRotation": "0 0 0",
        "AnatomicalOrientation": "RAI",
        "ElementSpacing": _line(grid.spacing),
        "DimSize": " ".join(map(str, grid.shape)),
        KEY: to_line(kept),
        "ElementType": "MET_FLOAT",
        END: "LOCAL",
    }
    text = "".join(f"{name} = {value}\n" for name, value in header.items())
    with path.open("wb") as file:
        file.write(text.encode())
        file.write(reversed_axes(values).data)


def read(path: Path) -> SDM:
    """Read a map, or any image of three dimensions: values become float32."""
    fields, begin = _header(path)
    grid, count, kept = _geometry(fields, path)
    values = plain_numbers(_values(fields, begin, grid.shape, path), path)
    verify(kept, values, str(path))
    return SDM(torch.from_numpy(values), grid, count, **sign_arguments(kept))


def read_grid(path: Path) -> Grid:
    """Read the geometry alone, turned to right-anterior-superior."""
    return _geometry(_header(path)[0], path)[0]


def read_record(path: Path) -> Any:
    """Read what is kept beside the values; None where that is nothing."""
    return _kept(_header(path)[0])


def _line(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _header(path: Path) -> tuple[dict[str, str], int]:
    """The fields of a header, and where it ends."""
    with path.open("rb") as file:
        start = file.read(LONGEST_HEADER)
    fields: dict[str, str] = {}
    begin = 0
    for line in start.splitlines(keepends=True):
        begin += len(line)
        name, equals, value = line.decode("latin-1").partition("=")
        if not equals:
            break
        fields[name.strip()] = value.strip()
        if name.strip() == END:
            break
    if END not in fields or "DimSize" not in fields:
        raise ValueError("it has no header of a MetaImage")
    return fields, begin


def _kept(fields: dict[str, str]) -> Any:
    if KEY not in fields and any(RECORD_CHECKSUM in value for value in fields.values()):
        raise ValueError(f"its record has lost its name, {KEY!r}")
    return json.loads(fields[KEY]) if KEY in fields else None


def _geometry(fields: dict[str, str], path: Path) -> tuple[Grid, int | None, Any]:
    shape = tuple(int(n) for n in fields["DimSize"].split())
    if len(shape) != 3:
        raise FormatError(f"{path} has the shape {shape}; an image of three dimensions is needed")
    kept = _kept(fields)
    if kept is not None and (lost := [names[0] for names in (TURN, SPACING, ORIGIN) if not fields.keys() & set(names)]):
        # Programs that move an image write where they moved it to.
        raise FormatError(f"{path} is damaged: its header has lost its {lost[0]}")
    affine = np.eye(4)
    turn = _numbers(fields, TURN, np.eye(3)).reshape(3, 3).T
    affine[:3, :3] = turn * _numbers(fields, SPACING, np.ones(3))
    affine[:3, 3] = _numbers(fields, ORIGIN, np.zeros(3))
    return geometry_of(kept, LPS @ affine + 0.0, shape, path)


def _numbers(fields: dict[str, str], names: tuple[str, ...], default: np.ndarray) -> np.ndarray:
    found = next((fields[name] for name in names if name in fields), None)
    return default if found is None else np.array([float(number) for number in found.split()])


def _values(fields: dict[str, str], begin: int, shape: tuple[int, ...], path: Path) -> np.ndarray:
    """Values (nx,ny,nz) behind the header, or in one file beside it."""
    if int(fields.get("ElementNumberOfChannels", "1")) != 1 or fields.get("BinaryData", "True") != "True":
        raise FormatError(f"{path} has text, or several values a voxel: one binary number each is needed")
    name = fields.get("ElementType", "")
    if name not in TYPES:
        raise FormatError(f"{path} has values of type {name[:40]}: plain numbers are needed")
    order = fields.get("BinaryDataByteOrderMSB", fields.get("ElementByteOrderMSB", "False"))
    dtype = np.dtype((">" if order == "True" else "<") + TYPES[name])
    data = path.read_bytes()[begin:] if fields[END] == "LOCAL" else _beside(fields[END], path)
    size = dtype.itemsize * int(np.prod(shape, dtype=np.int64))
    if fields.get("CompressedData", "False") == "True":
        data = _unpacked(data, size, path)
    elif fields[END] != "LOCAL":
        # The values are the file's end, whatever comes before.
        data = data[-size:] if fields.get("HeaderSize") == "-1" else data[int(fields.get("HeaderSize", "0")) :]
    if len(data) < size:
        raise FormatError(f"{path} is cut off: it has {len(data)} bytes of values, not {size}")
    return np.frombuffer(data, dtype, int(np.prod(shape, dtype=np.int64))).reshape(shape, order="F")


def _unpacked(packed: bytes, size: int, path: Path) -> bytes:
    """As many bytes as the header declares, to the end of the stream, where its checksum is."""
    unpacker = zlib.decompressobj()
    data = unpacker.decompress(packed, size + 1)
    if len(data) > size:
        raise FormatError(f"{path} is damaged: its values unpack to more than the voxels that its header declares")
    if not unpacker.eof:
        raise FormatError(f"{path} is cut off: its compressed values have no end")
    return data


def _beside(said: str, path: Path) -> bytes:
    name = PurePosixPath(said)
    if said == "LIST" or "%" in said:
        raise FormatError(f"{path} has its values in several files, which are not read: join them into one")
    if name.is_absolute() or ".." in name.parts:
        raise FormatError(f"{path} has its values in {said[:100]!r}: only files beside it are read")
    return (path.parent / name).read_bytes()
