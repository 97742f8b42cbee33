"""Geometry of MetaImage files (`.mha`, `.mhd`), ITK's own format, whose coordinates are left-posterior-superior."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sdm.core.as_grid import LPS
from sdm.core.grid import Grid
from sdm.errors import FormatError

# Headers are text and much shorter; values may follow in the same file.
LONGEST_HEADER = 1 << 16
# The last line of a header.
END = "ElementDataFile"


def read_grid(path: Path) -> Grid:
    """Read the geometry alone, turned to right-anterior-superior."""
    with path.open("rb") as file:
        start = file.read(LONGEST_HEADER)
    fields: dict[str, str] = {}
    for line in start.split(b"\n"):
        name, equals, value = line.decode("latin-1").partition("=")
        if not equals:
            break
        fields[name.strip()] = value.strip()
        if name.strip() == END:
            break
    if END not in fields or "DimSize" not in fields:
        raise ValueError("it has no header of a MetaImage")
    shape = [int(n) for n in fields["DimSize"].split()]
    if len(shape) != 3:
        raise FormatError(f"{path} has the shape {tuple(shape)}; an image of three dimensions is needed")
    affine = np.eye(4)
    # One row of the file for each axis of the image.
    turn = _numbers(fields, ("TransformMatrix", "Rotation", "Orientation"), np.eye(3)).reshape(3, 3).T
    affine[:3, :3] = turn * _numbers(fields, ("ElementSpacing", "ElementSize"), np.ones(3))
    affine[:3, 3] = _numbers(fields, ("Offset", "Position", "Origin"), np.zeros(3))
    return Grid.from_affine(LPS @ affine + 0.0, shape)


def _numbers(fields: dict[str, str], names: tuple[str, ...], default: np.ndarray) -> np.ndarray:
    found = next((fields[name] for name in names if name in fields), None)
    return default if found is None else np.array([float(number) for number in found.split()])
