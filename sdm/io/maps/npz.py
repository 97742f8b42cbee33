"""`.npz`: NumPy's archive: values, origin, spacing, direction, ambiguous_voxels, version, and made_from if known."""

from __future__ import annotations

from pathlib import Path
from typing import IO, Any

import numpy as np
import torch

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError
from sdm.io.files.direct_file import DirectFile
from sdm.io.files.npz_archive import MOST_BYTES, write_archive
from sdm.io.maps.check_dtype import plain_numbers
from sdm.io.maps.record import (
    DISAGREEMENTS,
    HOLE_SIZE,
    MADE_FROM,
    NORMALIZATION,
    SIGN_METHOD,
    TRUNCATED,
    from_record,
    record,
    sign_arguments,
    signs_of,
    stored_values,
)

FIELDS = ("version", "origin", "spacing", "shape", "direction", "ambiguous_voxels")
# Where it is known.
KNOWN = (MADE_FROM, SIGN_METHOD, HOLE_SIZE, DISAGREEMENTS, TRUNCATED, NORMALIZATION)
# An archive holds arrays alone, and no array is None.
UNCOUNTED = -1
# Bytes of what is beside the values, at most.
MOST_BESIDE = 1 << 20


def write(field: SDM, path: Path, made_from: str | None = None) -> None:
    """Write a map, not compressed: distances hardly shrink."""
    kept = record(field.grid, field.ambiguous_voxels, made_from, signs_of(field))
    if kept["ambiguous_voxels"] is None:
        kept["ambiguous_voxels"] = UNCOUNTED
    arrays: dict[str, Any] = {name: np.asarray(kept[name]) for name in (*FIELDS, *KNOWN) if name in kept}
    values = stored_values(field)
    # A very large one is NumPy's to write, which goes back and forth in it.
    with DirectFile(path, values.nbytes) if values.nbytes < MOST_BYTES // 2 else path.open("wb") as file:
        write_archive(file, {"values": values, **arrays})


def read(path: Path) -> SDM:
    """Read a map."""
    with path.open("rb") as file:
        archive = _open(file, path)
        grid, count = _geometry(archive, path)
        _check_values(archive, grid, path)
        values = torch.from_numpy(plain_numbers(archive["values"], path))
        return SDM(values, grid, count, **sign_arguments(_record(archive)))


def read_grid(path: Path) -> Grid:
    """Read the geometry alone."""
    with path.open("rb") as file:
        return _geometry(_open(file, path), path)[0]


def read_record(path: Path) -> Any:
    """Read what is kept beside the values."""
    with path.open("rb") as file:
        return _record(_open(file, path))


def _open(file: IO[bytes], path: Path) -> Any:
    # From a path NumPy would leave the file open where the archive is damaged.
    archive = np.load(file, allow_pickle=False)
    if not isinstance(archive, np.lib.npyio.NpzFile):
        raise FormatError(f"{path} is not an .npz archive")
    members = archive.zip.infolist() if archive.zip else []
    beside = sum(info.file_size for info in members if info.filename != "values.npy")
    if beside > MOST_BESIDE:
        raise FormatError(f"{path} has {beside:,} bytes beside its values: it was not written by sdm, or is damaged")
    return archive


def _check_values(archive: Any, grid: Grid, path: Path) -> None:
    """Refuse values of another shape than the grid's before they are read."""
    with archive.zip.open("values.npy") as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape = read(file)[0]
    if shape != grid.shape:
        raise FormatError(f"{path} is damaged: its values have the shape {shape}, and its grid {grid.shape}")


def _geometry(archive: Any, path: Path) -> tuple[Grid, int | None]:
    return from_record(_record(archive), str(path))


def _record(archive: Any) -> dict[str, Any]:
    names = (*FIELDS, *KNOWN) if "values" in archive else ()
    found = {name: archive[name].tolist() for name in names if name in archive}
    if found.get("ambiguous_voxels") == UNCOUNTED:
        found["ambiguous_voxels"] = None
    return found
