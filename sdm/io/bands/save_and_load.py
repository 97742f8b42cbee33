"""Narrow bands to files and back; `sdm.io.save` and `sdm.io.load` come here with them."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

from sdm.core.grid import Grid
from sdm.core.sparse_sdm import SparseSDM
from sdm.errors import FormatError
from sdm.io.files.atomic import replacing
from sdm.io.maps.formats import FORMATS as MAP_FORMATS
from sdm.io.maps.formats import HEADERS, check_target, format_of

FORMATS = ("npz", "zarr", "nvdb")


def check_band_target(path: Path) -> ModuleType:
    """The format of a file to write a band to, if it can be written there.

    Raises:
        FormatError: As `sdm.io.check_target`, or an ending that bands have not.
    """
    return _module(check_target(path).name, path)


def save_band(band: SparseSDM, path: Path, made_from: str | None = None) -> None:
    """Write a band to `.npz`, `.zarr` or `.nvdb`; atomic.

    Raises:
        FormatError: See `check_band_target`.
    """
    chosen = check_band_target(path)
    with replacing(path) as part:
        chosen.write(band, part, made_from)


def is_band(path: Path) -> bool:
    """True if a file that is there has a narrow band and not a map."""
    name = format_of(path, MAP_FORMATS | HEADERS).name
    return name in FORMATS and _module(name, path).is_band(path)


def read_band(path: Path) -> SparseSDM:
    """Read a band from a file that has one."""
    return _module(format_of(path).name, path).read(path)


def band_origin(path: Path) -> tuple[Grid, str | None]:
    """The grid of a file's band, and the digest of the mesh that it is made from, if it is known."""
    return _module(format_of(path).name, path).read_origin(path)


def _module(name: str, path: Path) -> ModuleType:
    if name not in FORMATS:
        raise FormatError(f"{path} is no place for a narrow band: use one of .{', .'.join(FORMATS)}")
    return importlib.import_module(f"sdm.io.bands.{name}")
