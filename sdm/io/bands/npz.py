"""Bands in `.npz`: blocks, values, inside, and a record, as JSON. The archive has a checksum of each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sdm.core.grid import Grid
from sdm.core.sparse_sdm import SparseSDM
from sdm.io.bands.band_record import ARRAYS, arrays_of, band_from, band_record
from sdm.io.maps.record import BAND_KEY, MADE_FROM, from_record


def write(band: SparseSDM, path: Path, made_from: str | None = None) -> None:
    """Write a band, not compressed: distances hardly shrink."""
    kept: dict[str, Any] = {**arrays_of(band), BAND_KEY: np.asarray(json.dumps(band_record(band, made_from)))}
    with path.open("wb") as file:
        np.savez(file, **kept)


def read(path: Path) -> SparseSDM:
    """Read a band."""
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        arrays = {name: torch.from_numpy(np.ascontiguousarray(archive[name])) for name in ARRAYS}
        return band_from(json.loads(str(archive[BAND_KEY])), arrays, str(path))


def read_origin(path: Path) -> tuple[Grid, str | None]:
    """The grid, and the digest of the mesh."""
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        kept = json.loads(str(archive[BAND_KEY]))
        return from_record(kept, str(path))[0], kept.get(MADE_FROM)


def is_band(path: Path) -> bool:
    """True if an archive has a band."""
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        return set(ARRAYS) <= set(archive.files)
