"""`.vti`, VTK's and ParaView's images: voxel centres are the image's points, values `implicit_distance`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import torch

from sdm.core.axis_order import reversed_axes
from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.core.to_libraries import IMPLICIT_DISTANCE
from sdm.errors import FormatError
from sdm.io.files.vtk_xml import VtkFile, data_array, write_file
from sdm.io.maps.check_dtype import plain_numbers
from sdm.io.maps.header_record import geometry_of
from sdm.io.maps.record import KEY, RECORD_CHECKSUM, record, sign_arguments, signs_of, to_line, verify, with_checksum

KIND = "ImageData"


# The name of the record's checksum, letter by letter.
CHECKSUM_CODES = f" {' '.join(str(ord(letter)) for letter in RECORD_CHECKSUM)} "


def write(field: SDM, path: Path, made_from: str | None = None) -> None:
    """Write a map, not compressed: distances hardly shrink."""
    grid, values = field.grid, field.numpy().astype("<f4", copy=False)
    kept = with_checksum(record(grid, field.ambiguous_voxels, made_from, signs_of(field)), values)
    # VTK counts along x first.
    flat = reversed_axes(values).ravel()
    extent = " ".join(f"0 {n - 1}" for n in grid.shape)
    codes = " ".join(str(code) for code in [*to_line(kept).encode(), 0])
    inside = (
        f'<ImageData WholeExtent="{extent}" Origin="{_line(grid.origin)}" Spacing="{_line(grid.spacing)}" '
        f'Direction="{_line(np.ravel(grid.direction))}">\n'
        f'<FieldData>\n<Array type="String" Name="{KEY}" NumberOfTuples="1" format="ascii">\n{codes}\n</Array>\n'
        f'</FieldData>\n<Piece Extent="{extent}">\n<PointData Scalars="{IMPLICIT_DISTANCE}">\n'
        f"{data_array(IMPLICIT_DISTANCE, flat, 0)}</PointData>\n</Piece>\n</ImageData>\n"
    )
    with path.open("wb") as file:
        write_file(file, KIND, inside, [flat])


def read(path: Path) -> SDM:
    """Read a map, or the active scalars of any image's points: values become float32."""
    file, image = _opened(path)
    grid, count, kept = geometry_of(_kept(file, image), *_geometry(image), path)
    pieces = image.findall("Piece")
    if len(pieces) != 1:
        raise FormatError(f"{path} has its values in {len(pieces)} pieces, which are not read: join them into one")
    array = _scalars(pieces[0], path)
    found = file.values(array)
    if found.shape != (np.prod(grid.shape),):
        raise ValueError(f"it has values of shape {found.shape} for {grid.shape} points")
    values = plain_numbers(found.reshape(grid.shape, order="F"), path)
    verify(kept, values, str(path))
    return SDM(torch.from_numpy(values), grid, count, **sign_arguments(kept))


def read_grid(path: Path) -> Grid:
    """Read the geometry alone."""
    file, image = _opened(path)
    return geometry_of(_kept(file, image), *_geometry(image), path)[0]


def read_record(path: Path) -> Any:
    """Read what is kept beside the values; None where that is nothing."""
    return _kept(*_opened(path))


def _line(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _opened(path: Path) -> tuple[VtkFile, ET.Element]:
    file = VtkFile(path.read_bytes(), KIND)
    image = file.root.find(KIND)
    if image is None:
        raise ValueError("it has no image")
    return file, image


def _geometry(image: ET.Element) -> tuple[np.ndarray, tuple[int, ...]]:
    """The affine matrix of the voxel centres, and their numbers along the axes."""
    ends = [int(n) for n in image.get("WholeExtent", "").split()]
    if len(ends) != 6:
        raise ValueError("it does not say how many points it has")
    affine = np.eye(4)
    direction = np.array(image.get("Direction", "1 0 0 0 1 0 0 0 1").split(), dtype=np.float64).reshape(3, 3)
    affine[:3, :3] = direction * np.array(image.get("Spacing", "1 1 1").split(), dtype=np.float64)
    origin = np.array(image.get("Origin", "0 0 0").split(), dtype=np.float64)
    # The origin is the place of index zero, with which an extent need not begin.
    affine[:3, 3] = origin + affine[:3, :3] @ ends[::2]
    return affine, tuple(high - low + 1 for low, high in zip(ends[::2], ends[1::2], strict=True))


def _kept(file: VtkFile, image: ET.Element) -> Any:
    for array in image.iterfind("FieldData/"):
        if array.get("Name") == KEY:
            # Other programs write it again in the way of their values.
            return json.loads(file.values(array).tobytes().rstrip(b"\0"))
        if CHECKSUM_CODES in f" {array.text or ''} ":
            raise ValueError(f"its record has lost its name, {KEY!r}")
    return None


def _scalars(piece: ET.Element, path: Path) -> ET.Element:
    """The values of the points: the active scalars, else the only ones."""
    points = piece.find("PointData")
    arrays = [] if points is None else [a for a in points if a.get("NumberOfComponents", "1") == "1"]
    active = None if points is None else points.get("Scalars")
    chosen = [a for a in arrays if a.get("Name") in (active, IMPLICIT_DISTANCE)] or arrays
    if not chosen:
        raise FormatError(f"{path} has no values at its points: values of cells lie half a voxel elsewhere")
    if len(chosen) > 1 and active is None:
        names = ", ".join(str(a.get("Name"))[:40] for a in arrays)
        raise FormatError(f"{path} has several arrays, {names}: make one of them the active scalars")
    return next((a for a in chosen if a.get("Name") == active), chosen[0])
