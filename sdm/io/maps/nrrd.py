"""`.nrrd` by pynrrd: space directions and origin, the exact geometry in a key/value pair."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import torch

from sdm.core.axis_order import reversed_axes
from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError
from sdm.io.maps.check_dtype import plain_numbers
from sdm.io.maps.header_record import geometry_of
from sdm.io.maps.nrrd_data import read_header, read_values
from sdm.io.maps.record import (
    KEY,
    RECORD_CHECKSUM,
    record,
    sign_arguments,
    signs_of,
    to_line,
    verify,
    with_checksum,
)

SPACE = "right-anterior-superior"
# Axes of the spaces of the NRRD standard that point the other way than right, anterior and superior.
FLIPPED = {
    "left-anterior-superior": (-1, 1, 1),
    "las": (-1, 1, 1),
    "left-posterior-superior": (-1, -1, 1),
    "lps": (-1, -1, 1),
}
# Four-dimensional spaces end like this.
WITH_TIME = "-time"
# Bytes from the begin in which that comment is, and no value.
EARLY = 64


def write(field: SDM, path: Path, made_from: str | None = None) -> None:
    """Write a map, not compressed: distances hardly shrink."""
    affine = field.grid.affine
    values = field.numpy().astype("<f4", copy=False)
    kept = with_checksum(record(field.grid, field.ambiguous_voxels, made_from, signs_of(field)), values)
    header = {
        "space": SPACE,
        "space directions": affine[:3, :3].T,
        "space origin": affine[:3, 3],
        "kinds": ["domain"] * 3,
        "endian": "little",
        "encoding": "raw",
        KEY: to_line(kept),
    }
    with _WithoutDate(path.open("wb", buffering=0)) as file:
        # So that it lies as the file does.
        nrrd.write(file, reversed_axes(values).T, header, index_order="F")


class _WithoutDate(io.BufferedWriter):
    """A file that leaves out pynrrd's comment about the time, so that the same map gives the same bytes."""

    def write(self, piece: Any, /) -> int:
        # Values that happen to begin so come later.
        if self.tell() < EARLY and piece.startswith(b"# on "):
            return len(piece)
        return super().write(piece)


def read(path: Path) -> SDM:
    """Read a map, or any image of three dimensions: values become float32."""
    read_header(path)
    with path.open("rb") as file:
        header = nrrd.read_header(file)
        grid, count, kept = _geometry(header, path)
        values = plain_numbers(read_values(file, header, path), path)
    verify(kept, values, str(path))
    return SDM(torch.from_numpy(values), grid, count, **sign_arguments(kept))


def read_grid(path: Path) -> Grid:
    """Read the geometry alone, also from a detached header (`.nhdr`). Left and posterior axes are turned to RAS+."""
    return _geometry(read_header(path), path)[0]


def read_record(path: Path) -> Any:
    """Read what is kept beside the values; None where that is nothing."""
    header = read_header(path)
    return json.loads(header[KEY]) if KEY in header else None


def _geometry(header: Any, path: Path) -> tuple[Grid, int | None, Any]:
    """Grid, count of ambiguous voxels, and the record that both are from; None where the image's header tells."""
    shape = tuple(int(n) for n in header["sizes"])
    if len(shape) != 3:
        raise FormatError(f"{path} has the shape {shape}; an image of three dimensions is needed")
    affine = _affine(header, path)
    if KEY not in header and any(RECORD_CHECKSUM in str(value) for value in header.values()):
        raise FormatError(f"{path} is damaged: its record has lost its name, {KEY!r}; compute or copy it again")
    if KEY in header and not {"space directions", "space origin"} <= set(header):
        # Programs that move an image write where they moved it to.
        raise FormatError(f"{path} is damaged: its header has lost its space directions or its space origin")
    return geometry_of(json.loads(header[KEY]) if KEY in header else None, affine, shape, path)


def _affine(header: Any, path: Path) -> np.ndarray:
    affine = np.eye(4)
    if "space directions" in header:
        directions = np.asarray(header["space directions"], dtype=np.float64)
        if directions.shape != (3, 3) or not np.isfinite(directions).all():
            raise FormatError(f"{path} has no direction for each of its axes")
        affine[:3, :3] = directions.T
    else:
        affine[:3, :3] = np.diag(header.get("spacings", (1.0, 1.0, 1.0)))
    if "space origin" not in header and np.isfinite(np.asarray(header.get("axis mins", math.nan), np.float64)).any():
        # Programs differ in whether that is a voxel's centre or its edge.
        raise FormatError(f"{path} says by axis mins where it begins: give it a space origin instead")
    affine[:3, 3] = header.get("space origin", (0.0, 0.0, 0.0))
    space = str(header.get("space", "")).lower().removesuffix(WITH_TIME)
    affine[:3] *= np.array(FLIPPED.get(space, (1, 1, 1)))[:, None]
    return affine + 0.0
